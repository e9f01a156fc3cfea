/* A libFuzzer target: any stream, cut anywhere, with arrays of any size, against
 * plain.c on the whole; then the frames encoded and decoded again. Aborts on any
 * difference and on any broken law of canser.h.
 *
 *     clang -g -O1 -fsanitize=fuzzer,address,undefined -I csrc \
 *         tests/c/fuzz.c tests/c/plain.c tests/c/drive.c csrc/[a-z]*.c
 *
 * With -DFUZZ_MAIN it has a main that runs the files given as arguments. With
 * -DFUZZ_PROTOCOL=N only the N-th protocol is tried.
 *
 * The first bytes of the input choose, the rest is the stream:
 *
 *     protocol, options | tick | frame_cap | control_cap | n | n lengths of pieces | stream
 */
#include "drive.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum {
    OPTION_NO_ENDS = 0x20,
    OPTION_NO_OFFSETS = 0x40,
    OPTION_NO_CONTROLS = 0x80,
    STREAM_MAX = 1 << 16
};

static void *allocate(size_t size)
{
    /* malloc(0) may be NULL, and NULL has a meaning of its own. */
    void *p = malloc(size ? size : 1);

    if (!p)
        abort();
    return p;
}

static void *place(drive_slot slot, size_t size)
{
    (void)slot;
    return allocate(size);
}

static void drop(drive_slot slot, void *p, size_t size)
{
    (void)slot;
    (void)size;
    free(p);
}

static void expect(const char *what)
{
    if (what) {
        fprintf(stderr, "FAILED %s\n", what);
        abort();
    }
}

static void expect_that(bool holds, const char *what)
{
    expect(holds ? NULL : what);
}

/* The next byte of the input, or 0 behind its end. */
static uint8_t take(const uint8_t **data, size_t *size)
{
    if (!*size)
        return 0;
    --*size;
    return *(*data)++;
}

static plain_stream new_stream(size_t len)
{
    const size_t cap = len / 2 + 2;

    return (plain_stream){.frames = allocate(cap * sizeof(canser_frame)),
                          .offsets = allocate(cap * sizeof(int64_t)),
                          .ends = allocate(cap * sizeof(int64_t)),
                          .controls = allocate(cap * sizeof(canser_control)),
                          .row_cap = cap};
}

static void free_rows(const plain_stream *stream)
{
    free(stream->frames);
    free(stream->offsets);
    free(stream->ends);
    free(stream->controls);
}

/* Whether every time is ticks times the unit without a turn through 2^64. Where
 * one has turned, no encoder can know the ticks it came from. The first time is
 * under 2^32 ticks and no step is over 2^31, so with a unit this small none can
 * turn without being over the limit first. */
static bool times_are_exact(const plain_stream *stream, int64_t tick_ns)
{
    const int64_t limit = INT64_MAX / 2;
    bool exact = tick_ns <= limit >> 32;

    for (size_t i = 0; i < stream->frame_count; i++)
        exact &= stream->frames[i].ts <= limit && stream->frames[i].ts >= -limit;
    return exact;
}

/* Encode the frames, exactly as plain.c does, and decode them again. */
static void check_way_back(const plain_stream *stream, int protocol, int64_t tick_ns,
                           size_t missing)
{
    const size_t count = stream->frame_count;
    canser_frame *const frames = allocate(count * sizeof *frames);
    uint8_t *const expected = allocate(count * CANSER_PACKET_MAX);
    size_t len = 0, fit_count = 0, fit_len = 0;

    if (count)
        memcpy(frames, stream->frames, count * sizeof *frames);
    if (protocol == PLAIN_serial && !times_are_exact(stream, tick_ns)) {
        for (size_t i = 0; i < count; i++)
            frames[i].ts = 0;
    }
    for (size_t i = 0; i < count; i++) {
        int refusal;
        len += plain_encode(protocol, tick_ns, &frames[i], expected + len, &refusal);
        expect_that(refusal == CANSER_REFUSAL_NONE, "a decoded frame is refused");
    }

    /* With room for all, then for some. */
    for (int i = 0; i < 2; i++) {
        const size_t cap = i ? len - (missing < len ? missing : len) : len;
        uint8_t *const out = allocate(cap);
        canser_encoded result;

        fit_count = fit_len = 0;
        while (fit_count < count) {
            uint8_t packet[CANSER_PACKET_MAX];
            int refusal;
            const size_t packet_len =
                plain_encode(protocol, tick_ns, &frames[fit_count], packet, &refusal);
            if (packet_len > cap - fit_len)
                break;
            fit_len += packet_len;
            fit_count++;
        }
        expect_that(canser_encode(canser_protocol_at((size_t)protocol), tick_ns, frames, count, out,
                                  cap, &result) == CANSER_OK,
                    "encode: status");
        expect_that(result.refusal == CANSER_REFUSAL_NONE, "encode: refusal");
        expect_that(result.frame_count == fit_count, "encode: frame_count");
        expect_that(result.byte_count == fit_len, "encode: byte_count");
        expect_that(memcmp(out, expected, fit_len) == 0, "encode: bytes");
        free(out);
    }

    /* Nothing in a decoded frame is lost on the way back; only the spelling on
     * the wire is not what it was. */
    plain_stream again = new_stream(len);
    plain_begin(&again, protocol, tick_ns);
    plain_scan(&again, expected, len, true);
    expect_that(again.frame_count == count, "way back: the number of frames differs");
    expect_that(memcmp(again.frames, frames, count * sizeof *frames) == 0,
                "way back: a frame differs");
    expect_that(again.stats.bytes_framed == len, "way back: a byte is in no frame");
    free_rows(&again);
    free(expected);
    free(frames);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const int64_t ticks[] = {1000000, 1000, 1000000000, 1, 10000, 7, INT64_MAX};

    if (size > STREAM_MAX)
        return 0;
    const uint8_t options = take(&data, &size);
#ifdef FUZZ_PROTOCOL
    const int protocol = FUZZ_PROTOCOL;
#else
    const int protocol = options % PLAIN_PROTOCOL_COUNT;
#endif
    const int64_t tick_ns = ticks[take(&data, &size) % (sizeof ticks / sizeof *ticks)];
    const size_t frame_cap = 1 + (size_t)take(&data, &size);
    const size_t control_cap = 1 + (size_t)take(&data, &size);
    const size_t piece_count = take(&data, &size) % 16;
    uint8_t piece_lens[16];
    for (size_t i = 0; i < piece_count; i++)
        piece_lens[i] = take(&data, &size);

    plain_stream open_stream = new_stream(size), ended_stream = new_stream(size);
    plain_begin(&open_stream, protocol, tick_ns);
    plain_scan(&open_stream, data, size, false);
    plain_begin(&ended_stream, protocol, tick_ns);
    plain_scan(&ended_stream, data, size, true);

    const plain_stream rows = new_stream(size);
    drive driven = {.frames = rows.frames,
                    .offsets = rows.offsets,
                    .ends = rows.ends,
                    .controls = rows.controls,
                    .row_cap = rows.row_cap,
                    .no_offsets = (options & OPTION_NO_OFFSETS) != 0,
                    .no_ends = (options & OPTION_NO_ENDS) != 0,
                    .no_controls = (options & OPTION_NO_CONTROLS) != 0,
                    .place = place,
                    .drop = drop};
    drive_begin(&driven, protocol, tick_ns);
    size_t pos = 0;
    for (size_t i = 0; i < piece_count; i++) {
        const size_t len = piece_lens[i] < size - pos ? piece_lens[i] : size - pos;
        drive_feed(&driven, data + pos, len, frame_cap, control_cap);
        pos += len;
    }
    drive_feed(&driven, data + pos, size - pos, frame_cap, control_cap);
    expect(drive_compare(&driven, &open_stream));
    drive_flush(&driven, frame_cap, control_cap);
    expect(drive_compare(&driven, &ended_stream));

    check_way_back(&ended_stream, protocol, tick_ns, frame_cap);
    free_rows(&open_stream);
    free_rows(&ended_stream);
    free_rows(&rows);
    return 0;
}

#ifdef FUZZ_MAIN
int main(int argc, char **argv)
{
    for (int i = 1; i < argc; i++) {
        uint8_t *const input = allocate(STREAM_MAX);
        FILE *const file = fopen(argv[i], "rb");

        if (!file) {
            perror(argv[i]);
            return 2;
        }
        const size_t len = fread(input, 1, STREAM_MAX, file);
        fclose(file);
        /* At its very size, so that a sanitizer sees where it ends. */
        uint8_t *const exact = allocate(len);
        memcpy(exact, input, len);
        free(input);
        LLVMFuzzerTestOneInput(exact, len);
        free(exact);
    }
    printf("%d passed, 0 failed\n", argc - 1);
    return 0;
}
#endif
