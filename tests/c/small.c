/* Small calls: what a binding does with one call, and what they leave to others; and one stream
 * that several threads use at once.
 */
#include "canser.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { BYTES = 3000, ROWS = BYTES, PIECE = 300, THREADS = 4, TURNS = 2000 };

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

static canser_frame random_frame(void)
{
    canser_frame frame = {.id = (uint32_t)random_below(0x800), .dlc = (uint8_t)random_below(9)};

    frame.ts = (int64_t)random_below(1000) * 1000000;
    memset(frame.data, (int)random_below(256), frame.dlc);
    return frame;
}

/* Frames, the control packets that the row knows, and noise. */
static size_t make_stream(const canser_protocol *row, uint8_t *stream, size_t len)
{
    const canser_packet *const known[] = {&row->ping, &row->status_request};
    size_t done = 0;

    while (done + CANSER_PACKET_MAX <= len) {
        const size_t kind = random_below(30);
        if (kind < 2) {
            memcpy(stream + done, known[kind]->bytes, known[kind]->len);
            done += known[kind]->len;
        } else if (kind < 4) {
            stream[done++] = (uint8_t)random_below(256);
        } else {
            const canser_frame frame = random_frame();
            canser_encoded result;
            canser_encode(row, 1000000, &frame, 1, stream + done, len - done, &result);
            done += result.byte_count;
        }
    }
    return done;
}

/* Everything that a stream gives, by one way or by the other. */
typedef struct {
    canser_frame frames[ROWS];
    int64_t offsets[ROWS], ends[ROWS];
    canser_control controls[ROWS];
    size_t frame_count, control_count;
} found;

static found expected, got;

static void feed_whole(canser_decoder *decoder, const uint8_t *data, size_t len, size_t frame_cap,
                       found *to, size_t *used)
{
    canser_batch batch = {.frames = to->frames + to->frame_count,
                          .frame_cap = frame_cap,
                          .offsets = to->offsets + to->frame_count,
                          .ends = to->ends + to->frame_count,
                          .controls = to->controls + to->control_count,
                          .control_cap = ROWS - to->control_count};

    check(canser_decoder_feed(decoder, data, len, &batch, used) == CANSER_OK, "a feed fails");
    to->frame_count += batch.frame_count;
    to->control_count += batch.control_count;
}

/* The next bytes by a small call, and by another one where that does nothing. Returns those used.
 */
static size_t feed_small(canser_stream *stream, const uint8_t *data, size_t len, size_t frame_cap)
{
    const canser_target target = {got.frames + got.frame_count, frame_cap,
                                  got.offsets + got.frame_count, got.ends + got.frame_count};
    const canser_decoder before = stream->decoder;
    const int64_t result = canser_stream_feed(stream, data, len, &target);

    if (result >= 0) {
        const size_t count = (size_t)(result & UINT32_MAX), left = (size_t)(result >> 32);
        check(count <= frame_cap && left <= len && (!left || count == frame_cap),
              "bytes are left though there is room");
        check(stream->decoder.stats.frames - before.stats.frames == count, "another count");
        check(!stream->keeps_controls || stream->decoder.stats.controls == before.stats.controls,
              "a control packet is lost");
        got.frame_count += count;
        return len - left;
    }
    check(stream->keeps_controls && !memcmp(&before, &stream->decoder, sizeof before),
          "something was done by a call that says it did nothing");
    const uint64_t controls = stream->decoder.stats.controls;
    size_t used;
    feed_whole(&stream->decoder, data, len, frame_cap, &got, &used);
    check(stream->decoder.stats.controls > controls, "a small call gives up without a reason");
    return used;
}

/* Bytes behind those that are held may be anything. */
static bool is_same_state(const canser_decoder *a, const canser_decoder *b)
{
    return !memcmp(&a->clock, &b->clock, sizeof a->clock) &&
           !memcmp(&a->stats, &b->stats, sizeof a->stats) && a->skip_end == b->skip_end &&
           a->carry_len == b->carry_len && !memcmp(a->carry, b->carry, a->carry_len);
}

static void test_small_calls(const canser_protocol *row)
{
    static uint8_t data[BYTES];
    const size_t len = make_stream(row, data, BYTES);
    canser_decoder whole;
    canser_stream stream = {.keeps_controls = random_below(2) != 0};
    size_t used;

    memset(&expected, 0, sizeof expected);
    memset(&got, 0, sizeof got);
    canser_decoder_init(&whole, row, 1000000);
    canser_decoder_init(&stream.decoder, row, 1000000);
    feed_whole(&whole, data, len, ROWS, &expected, &used);
    for (size_t pos = 0; pos < len;) {
        const size_t piece = random_below(PIECE);
        pos += feed_small(&stream, data + pos, piece < len - pos ? piece : len - pos,
                          1 + random_below(20));
    }
    check(is_same_state(&whole, &stream.decoder), "another state");
    if (!stream.keeps_controls)
        memset(expected.controls, 0, sizeof expected.controls), expected.control_count = 0;
    check(!memcmp(&expected, &got, sizeof got), "other frames or control packets");

    canser_batch rest = {.frames = expected.frames + expected.frame_count,
                         .frame_cap = ROWS - expected.frame_count};
    canser_decoder_flush(&whole, &rest);
    const size_t count = expected.frame_count + rest.frame_count;
    memset(&got, 0, sizeof got);
    const int64_t result = canser_decode_small(row, 1000000, data, len, got.frames, count + 1);
    check(result == (int64_t)(count | whole.stats.bytes_skipped << 32), "another count of all");
    check(!memcmp(expected.frames, got.frames, count * sizeof *got.frames), "other frames of all");
    if (count > 1)
        check(canser_decode_small(row, 1000000, data, len, got.frames, count - 1) == -1,
              "frames are lost where there is no room");
}

static void test_arguments(const canser_protocol *row)
{
    static uint8_t data[CANSER_SMALL_MAX + 1];
    static const uint8_t byte;
    canser_stream stream = {0};
    canser_frame frame;
    canser_target target = {&frame, 1, NULL, NULL}, none = {&frame, 0, NULL, NULL},
                  null = {NULL, 1, NULL, NULL}, same = {(canser_frame *)data, 1, NULL, NULL};

    check(canser_stream_feed(&stream, &byte, 1, &target) == -1, "no protocol");
    canser_decoder_init(&stream.decoder, row, 1);
    check(canser_stream_feed(NULL, &byte, 1, &target) == -1, "no stream");
    check(canser_stream_feed(&stream, &byte, 1, NULL) == -1, "no target");
    check(canser_stream_feed(&stream, &byte, 1, &none) == -1, "no room");
    check(canser_stream_feed(&stream, &byte, 1, &null) == -1, "no frames");
    check(canser_stream_feed(&stream, NULL, 1, &target) == -1, "no data");
    check(canser_stream_feed(&stream, data, sizeof(canser_frame), &same) == -1, "overlap");
    check(canser_stream_feed(&stream, data, CANSER_SMALL_MAX + 1, &target) == -1, "too long");
    check(canser_decode_small(NULL, 1, &byte, 1, &frame, 1) == -1, "no protocol at once");
    check(canser_decode_small(row, 0, &byte, 1, &frame, 1) == -1, "no tick");
    check(canser_decode_small(row, 1, NULL, 1, &frame, 1) == -1, "no data at once");
    check(canser_decode_small(row, 1, &byte, 1, NULL, 1) == -1, "no frames at once");
    check(canser_decode_small(row, 1, data, CANSER_SMALL_MAX + 1, &frame, 1) == -1,
          "too long at once");
    check(stream.decoder.stats.bytes_in == 0, "bytes were taken");

    check(canser_stream_take(&stream) == 1, "a free stream");
    check(canser_stream_take(&stream) == 0, "a stream that is taken");
    check(canser_stream_feed(&stream, NULL, 0, &target) == -1, "a feed of a stream that is taken");
    canser_stream_release(&stream);
    check(canser_stream_feed(&stream, NULL, 0, &target) == 0, "a feed of a free stream");
    canser_stream_release(&stream);
    check(canser_stream_take(&stream) == 1, "a stream that was released twice");
    check(canser_stream_take(NULL) == 0, "no stream to take");
    canser_stream_release(NULL);
}

/* One stream for all threads. */
static canser_stream shared;
static uint8_t packet[CANSER_PACKET_MAX];
static size_t packet_len;

static void *use_shared(void *arg)
{
    canser_frame frames[2];
    const canser_target target = {frames, 2, NULL, NULL};
    size_t done = 0, *const takes = arg;

    while (done < TURNS) {
        if (done % 3) {
            done += canser_stream_feed(&shared, packet, packet_len, &target) == 1;
        } else if (canser_stream_take(&shared)) {
            canser_batch batch = {.frames = frames, .frame_cap = 2};
            size_t used;
            canser_decoder_feed(&shared.decoder, packet, packet_len, &batch, &used);
            canser_stream_release(&shared);
            done++;
            ++*takes;
        }
    }
    return NULL;
}

static void test_threads(const canser_protocol *row)
{
    const canser_frame frame = {.id = 0x123, .dlc = 8};
    canser_encoded result;
    pthread_t threads[THREADS];
    size_t takes[THREADS] = {0}, all_takes = 0;

    memset(&shared, 0, sizeof shared);
    canser_decoder_init(&shared.decoder, row, 1);
    canser_encode(row, 1, &frame, 1, packet, sizeof packet, &result);
    packet_len = result.byte_count;
    for (int i = 0; i < THREADS; i++)
        check(!pthread_create(&threads[i], NULL, use_shared, &takes[i]), "no thread");
    for (int i = 0; i < THREADS; i++) {
        pthread_join(threads[i], NULL);
        all_takes += takes[i];
    }
    check(all_takes > 0 && shared.decoder.stats.frames == THREADS * TURNS, "frames are lost");
    check(shared.decoder.stats.bytes_framed == THREADS * TURNS * packet_len, "bytes are lost");
}

int main(void)
{
    const canser_protocol *row;

    for (size_t i = 0; (row = canser_protocol_at(i)); i++) {
        for (int turn = 0; turn < 300; turn++)
            test_small_calls(row);
        test_arguments(row);
        test_threads(row);
    }
    printf("%lu passed, %lu failed\n", passed, failed);
    return failed != 0;
}
