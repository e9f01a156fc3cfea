/* The caller's mistakes in calls of canser_chunk_decode(), canser_decoder_join() and
 * canser_chunk_deliver(), and chunks of nothing. */
#include "arena.h"
#include "bench.h"
#include "checks.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

/* A call of canser_chunk_decode() that must be refused. */
static void check_chunk_refused(bench *b, int expected, canser_chunk *chunk,
                                const canser_protocol *protocol, const uint8_t *data,
                                size_t data_len, size_t first, const char *what)
{
    const bench before = *b;

    now.part = what;
    b->batch.frame_count = b->batch.control_count = SIZE_MAX;
    check(canser_chunk_decode(chunk, protocol, 1, data, data_len, first, first + 9, 7, &b->batch) ==
              expected,
          "a chunk returns another status");
    check(b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the counts are not set by a chunk");
    check_arrays_kept(b, &before);
    set_bench(b);
}

static void check_chunk_arguments(bench *b)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    const size_t far = 1 << 14; /* further than a guess looks back */
    canser_chunk chunk;

    check_chunk_refused(b, CANSER_NULL, NULL, protocol, b->data, 64, 0, "chunk: self NULL");
    check_chunk_refused(b, CANSER_NULL, &chunk, NULL, b->data, 64, 0, "chunk: protocol NULL");
    check_chunk_refused(b, CANSER_NULL, &chunk, protocol, NULL, 1, 0, "chunk: data NULL");
    check_chunk_refused(b, CANSER_NULL, &chunk, protocol, NULL, 2 * far, far,
                        "chunk: data NULL, far on");
    b->batch.frame_cap = 0;
    check_chunk_refused(b, CANSER_NULL, &chunk, protocol, b->data, 64, 0, "chunk: frame_cap 0");
    b->batch.control_cap = 0;
    check_chunk_refused(b, CANSER_NULL, &chunk, protocol, b->data, 64, 0, "chunk: control_cap 0");
    b->batch.frames = NULL;
    check_chunk_refused(b, CANSER_NULL, &chunk, protocol, b->data, 64, 9, "chunk: frames NULL");
    b->batch.frames = behind(b->memory.frames, 1);
    b->batch.frame_cap = 2;
    check_chunk_refused(b, CANSER_MISALIGNED, &chunk, protocol, b->data, 64, 9,
                        "chunk: frames misaligned");
    b->batch.offsets = behind(b->memory.frames, sizeof b->memory - 8);
    check_chunk_refused(b, CANSER_OVERLAP, &chunk, protocol, b->data, 64, 0,
                        "chunk: offsets on frames");
    check_chunk_refused(b, CANSER_OVERLAP, &chunk, protocol, behind(b->offsets, 0), 8, 0,
                        "chunk: data on offsets");
    now.part = "chunk: tick";
    check(canser_chunk_decode(&chunk, protocol, 0, b->data, 64, 0, 64, 0, &b->batch) == CANSER_TICK,
          "another status");
    set_bench(b);
    now.part = "chunk: batch NULL";
    check(canser_chunk_decode(&chunk, protocol, 1, b->data, 64, 0, 64, 0, NULL) == CANSER_NULL,
          "another status");

    /* Nothing is there, or nothing is asked for: a chunk of nothing. */
    const size_t nothing[][3] = {{0, 0, 0},          {0, 9, 99},  {23, 0, 9}, {64, 64, 99},
                                 {64, far, far + 1}, {64, 30, 0}, {64, 0, 0}};
    for (size_t i = 0; i < sizeof nothing / sizeof *nothing; i++) {
        const size_t len = nothing[i][0];

        now.part = "chunk of nothing";
        now.len = i;
        b->batch.controls = NULL;
        check(canser_chunk_decode(&chunk, protocol, 1000, len ? b->data : NULL, len, nothing[i][1],
                                  nothing[i][2], 7, &b->batch) == CANSER_OK,
              "another status");
        check(b->batch.frame_count == 0 && b->batch.control_count == 0 && chunk.frame_count == 0 &&
                  chunk.begin == chunk.end && chunk.begin >= 7 && chunk.end <= 7 + len,
              "there is something in it");
        canser_decoder_init(&b->decoder, protocol, 1000);
        b->decoder.stats.bytes_in = chunk.begin;
        memcpy(&b->before, &b->decoder, sizeof b->before);
        check(canser_decoder_join(&b->decoder, &chunk, NULL) == CANSER_OK, "join: another status");
        check(memcmp(&b->before, &b->decoder, sizeof b->before) == 0, "the decoder has changed");
        set_bench(b);
    }
    now.len = 0;
}

static void check_join_arguments(bench *b)
{
    const size_t other = (size_t)(now.protocol + 1) % PLAIN_PROTOCOL_COUNT;
    canser_decoder decoder;
    canser_chunk chunk, before;
    canser_frame copies[4];

    /* A frame in front: the stream alone may have none. */
    const canser_frame sent = random_frame(now.protocol);
    int refusal;
    make_stream(now.protocol, KIND_CLEAN, b->data, sizeof b->data);
    plain_encode(now.protocol, 1000, &sent, b->data, &refusal);
    check(canser_chunk_decode(&chunk, b->decoder.protocol, b->decoder.clock.tick_ns, b->data, 64, 0,
                              64, 0, &b->batch) == CANSER_OK,
          "a chunk returns another status");
    check(chunk.frame_count > 0, "there is no frame");
    canser_frame *const frames = b->memory.frames;
    const size_t count = chunk.frame_count;
    memcpy(&before, &chunk, sizeof before);
    canser_decoder_init(&decoder, b->decoder.protocol, 1000);
    check(canser_decoder_join(NULL, &chunk, frames) == CANSER_NULL, "self NULL");
    check(canser_decoder_join(&decoder, NULL, frames) == CANSER_NULL, "chunk NULL");
    check(canser_decoder_join(&decoder, &chunk, NULL) == CANSER_NULL, "frames NULL");
    check(canser_decoder_join(&b->decoder, &chunk, frames) == CANSER_MISMATCH, "bytes are held");
    chunk.begin = b->decoder.stats.bytes_in;
    check(canser_decoder_join(&b->decoder, &chunk, frames) == CANSER_MISMATCH, "bytes are held");
    chunk.begin = 0;
    check(memcmp(&b->before, &b->decoder, sizeof b->before) == 0, "the decoder has changed");
    decoder.stats.bytes_in = 1;
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_MISMATCH, "another place");
    canser_decoder_init(&decoder, canser_protocol_at(other), 1000);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_MISMATCH, "another protocol");
    canser_decoder_init(&decoder, b->decoder.protocol, 999);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_MISMATCH, "another unit");
    check(memcmp(&before, &chunk, sizeof before) == 0, "the chunk has changed");
    /* A join that was refused is no harm. */
    canser_decoder_init(&decoder, b->decoder.protocol, 1000);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_OK, "another status");
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_MISMATCH, "joined twice");

    now.part = "deliver";
    memset(copies, UNUSED_BYTE, sizeof copies);
    check(canser_chunk_deliver(NULL, frames, 0, count, copies) == CANSER_NULL, "self NULL");
    check(canser_chunk_deliver(&chunk, NULL, 0, count, copies) == CANSER_NULL, "frames NULL");
    check(canser_chunk_deliver(&chunk, frames, 0, count, NULL) == CANSER_NULL, "out NULL");
    check(canser_chunk_deliver(&chunk, NULL, 0, 0, NULL) == CANSER_OK, "no frames");
    check(canser_chunk_deliver(&chunk, frames, 1, 0, copies) == CANSER_OK, "no frames");
    check(is_filled(copies, sizeof copies, UNUSED_BYTE), "out was written");
    check(canser_chunk_deliver(&chunk, frames, count - 1, 1, copies + 1) == CANSER_OK, "status");
    check(memcmp(copies[1].data, frames[count - 1].data, 8) == 0, "another frame");
    check(is_filled(copies, sizeof *copies, UNUSED_BYTE) &&
              is_filled(copies + 2, 2 * sizeof *copies, UNUSED_BYTE),
          "more than one frame was written");
    set_bench(b);
}

void test_chunk_arguments(void)
{
    static bench b;

    begin_part("chunk: arguments");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        set_bench(&b);
        check_chunk_arguments(&b);
    }
}

void test_join_arguments(void)
{
    static bench b;

    for (int protocol = 0; protocol < PLAIN_PROTOCOL_COUNT; protocol++) {
        begin_part("join");
        now.protocol = protocol;
        set_bench(&b);
        check_join_arguments(&b);
    }
}
