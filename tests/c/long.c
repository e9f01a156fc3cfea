/* A protocol whose packets are twice as long as any other's, and that has no fast forms: added to
 * the list by the build, it must work like all others, however the stream is cut.
 *
 *     5A | dlc | id u32 LE | 25 bytes, any | data[8] | sum
 *      0   1     2           6               31        39    sum: low byte of the sum of 1..38
 */
#ifndef CANSER_PROTOCOLS /* as the build defines it for all files */
#define CANSER_PROTOCOLS(ROW) ROW(long40, 40)
#endif
#include "protocol.h"

#include <stdio.h>

enum { START = 0x5A, LEN = 40, DATA_AT = 31, SUM_AT = 39 };

static uint8_t sum_of(const uint8_t *p)
{
    unsigned sum = 0;

    for (int i = 1; i < SUM_AT; i++)
        sum += p[i];
    return (uint8_t)sum;
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    (void)raw;
    if (p[0] != START)
        return probe_reject(CANSER_REJECT_MARKER);
    if (avail < 2)
        return probe_more();
    if (p[1] > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);
    if (avail < LEN)
        return probe_more();
    if (p[SUM_AT] != sum_of(p))
        return probe_reject(CANSER_REJECT_SUM);
    if (load_le32(p + 2) > ID_EXT_MAX)
        return probe_reject(CANSER_REJECT_ID);
    store_frame(frame, load_le32(p + 2), load_le32(p + 2) > ID_STD_MAX, 0, 0, p[1], p + DATA_AT);
    return probe_frame(LEN);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    (void)raw;
    memset(out, 0, LEN);
    out[0] = START;
    out[1] = frame->dlc;
    store_le32(out + 2, frame->id);
    memcpy(out + DATA_AT, frame->data, frame->dlc);
    out[SUM_AT] = sum_of(out);
    return out + LEN;
}

#define NAME       long40
#define START_MARK START
#define HAS_CLOCK  0
#define HAS_EXT    1
#define HAS_ERR    0
#define HAS_PLAIN  0
#define FRAME_MIN  LEN
#define FRAME_MAX  LEN
#define PACKET_MAX LEN
#include "scan.h"

static const struct canser_codec codec = {.scan = scan, .encode = encode, .refuse = refuse};

const canser_protocol canser_protocol_long40 = {
    .name = "long40",
    .aliases = "",
    .frame_min = LEN,
    .frame_max = LEN,
    .baudrate = 115200,
    .codec = &codec,
};

/* The test. */

enum { FRAMES = 400, BYTES = FRAMES * LEN + 1000 };

static unsigned long passed, failed;
static uint64_t state = 1;

static void check(bool holds, const char *what)
{
    passed += holds;
    failed += !holds;
    if (!holds && failed < 10)
        printf("FAILED %s\n", what);
}

static size_t random_below(size_t limit)
{
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (size_t)(state >> 33) % limit;
}

/* Frames with noise between them, and some with a bad sum. */
static size_t make_stream(uint8_t *stream)
{
    static canser_frame frames[FRAMES];
    size_t len = 0;

    for (size_t i = 0; i < FRAMES; i++) {
        const size_t noise = random_below(3) ? 0 : random_below(50);
        canser_encoded result;

        if (len + noise + LEN > BYTES)
            break;
        for (size_t k = 0; k < noise; k++)
            stream[len++] = random_below(3) ? (uint8_t)random_below(256) : START;
        frames[i] = (canser_frame){.id = (uint32_t)random_below(ID_EXT_MAX), .ext = 1};
        frames[i].dlc = (uint8_t)random_below(DLC_MAX + 1);
        memset(frames[i].data, (int)random_below(256), frames[i].dlc);
        check(canser_encode(&canser_protocol_long40, 1, &frames[i], 1, stream + len, BYTES - len,
                            &result) == CANSER_OK &&
                  result.byte_count == LEN,
              "a frame is not encoded");
        stream[len + SUM_AT] ^= random_below(20) == 0;
        len += LEN;
    }
    return len;
}

/* The rule of the scan, byte by byte; returns the frames. */
static size_t plain_decode(const uint8_t *stream, size_t len, canser_frame *frames,
                           int64_t *offsets, uint64_t *skipped)
{
    size_t count = 0, at = 0;

    *skipped = 0;
    while (at < len) {
        canser_frame *const frame = &frames[count];
        const uint8_t *const p = stream + at;
        const size_t left = len - at;

        if (p[0] == START && (left < 2 || p[1] <= DLC_MAX) && left < LEN)
            break;
        if (p[0] != START || p[1] > DLC_MAX || p[SUM_AT] != sum_of(p) ||
            load_le32(p + 2) > ID_EXT_MAX) {
            ++*skipped;
            at++;
            continue;
        }
        memset(frame, 0, sizeof *frame);
        frame->id = load_le32(p + 2);
        frame->ext = frame->id > ID_STD_MAX;
        frame->dlc = p[1];
        frame->ts = CANSER_NO_TIME;
        memcpy(frame->data, p + DATA_AT, frame->dlc);
        offsets[count++] = (int64_t)at;
        at += LEN;
    }
    return count;
}

int main(void)
{
    static uint8_t stream[BYTES];
    static canser_frame frames[FRAMES], expected[FRAMES];
    static int64_t offsets[FRAMES], ends[FRAMES], expected_offsets[FRAMES];

    for (int round = 0; round < 200; round++) {
        const size_t len = make_stream(stream);
        const size_t piece_max = 1 + random_below(random_below(2) ? 60 : 5000);
        uint64_t skipped;
        const size_t want = plain_decode(stream, len, expected, expected_offsets, &skipped);
        canser_decoder decoder;
        size_t count = 0, at = 0;

        canser_decoder_init(&decoder, &canser_protocol_long40, 1);
        for (int idle = 0; at < len && idle < 2;) {
            const size_t piece = 1 + random_below(piece_max), left = len - at;
            canser_batch batch = {.frames = frames + count,
                                  .frame_cap = 1 + random_below(FRAMES - count),
                                  .offsets = offsets + count,
                                  .ends = ends + count};
            size_t used;

            check(canser_decoder_feed(&decoder, stream + at, piece < left ? piece : left, &batch,
                                      &used) == CANSER_OK,
                  "another status");
            idle = used ? 0 : idle + 1;
            at += used;
            count += batch.frame_count;
            if (count == FRAMES)
                break;
        }
        check(at == len && count == want, "another number of frames");
        check(memcmp(frames, expected, want * sizeof *frames) == 0, "the frames differ");
        check(memcmp(offsets, expected_offsets, want * sizeof *offsets) == 0, "the offsets differ");
        for (size_t i = 0; i < want; i++)
            check(ends[i] == expected_offsets[i] + LEN, "an end differs");
        check(decoder.stats.bytes_skipped == skipped &&
                  decoder.stats.bytes_in ==
                      decoder.stats.bytes_framed + skipped + decoder.carry_len,
              "not all bytes are counted");
    }
    printf("%lu passed, %lu failed\n", passed, failed);
    return failed != 0;
}
