/* What canser.h promises of memory: nothing is read outside the input, nothing
 * is written outside the arrays, and the caller's mistakes are found before a
 * byte is touched. Every input and every array lies against a page that may not
 * be touched, once with its end and once with its start. POSIX only.
 *
 *     guard           all but more than 4 GiB in one call
 *     guard --huge    only that: it takes some seconds
 */
#define _DEFAULT_SOURCE /* MAP_ANONYMOUS, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "streams.h"
#include "tests.h"
#include "traffic.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* A decoder in the middle of a stream, and arrays to fill. */
typedef struct {
    canser_decoder decoder, before;
    canser_batch batch;
    size_t used;
    union {
        canser_frame frames[4];
        uint8_t bytes[4 * sizeof(canser_frame)];
    } memory;
    int64_t offsets[4];
    int64_t ends[4];
    canser_control controls[4];
    uint8_t data[64];
} bench;

/* Two bytes are held, and the clean stream goes on at data[2]. */
static void set_bench(bench *b)
{
    memset(b, UINT8_MAX, sizeof *b);
    make_stream(now.protocol, KIND_CLEAN, b->data, sizeof b->data);
    canser_decoder_init(&b->decoder, canser_protocol_at((size_t)now.protocol), 1000);
    b->batch = (canser_batch){.frames = b->memory.frames,
                              .frame_cap = 4,
                              .offsets = b->offsets,
                              .ends = b->ends,
                              .controls = b->controls,
                              .control_cap = 4,
                              .frame_count = SIZE_MAX,
                              .control_count = SIZE_MAX};
    canser_decoder_feed(&b->decoder, b->data, 1, &b->batch, &b->used);
    check(b->decoder.carry_len == 1, "a marker is not held");
    b->batch.frame_count = b->batch.control_count = b->used = SIZE_MAX;
    memcpy(&b->before, &b->decoder, sizeof b->before); /* with its padding */
}

/* A call on the bench that must be refused, and leave all as it was. */
static void check_refused(bench *b, int expected, const uint8_t *data, size_t len, const char *what)
{
    const canser_batch batch = b->batch;
    const bench before = *b;

    now.part = what;
    check(canser_decoder_feed(&b->decoder, data, len, &b->batch, &b->used) == expected,
          "feed returns another status");
    check(b->used == 0, "*used is not set");
    check(b->batch.frame_count == 0 && b->batch.control_count == 0, "the counts are not set");
    b->batch.frame_count = b->batch.control_count = b->used = SIZE_MAX;
    check(canser_decoder_advance(&b->decoder, data, len, len, &b->batch, &b->used) == expected,
          "advance returns another status");
    check(b->used == 0 && b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the results are not set by advance");
    check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0, "the decoder has changed");
    check(memcmp(&b->memory, &before.memory, sizeof b->memory) == 0 &&
              memcmp(b->offsets, before.offsets, sizeof b->offsets) == 0 &&
              memcmp(b->ends, before.ends, sizeof b->ends) == 0 &&
              memcmp(b->controls, before.controls, sizeof b->controls) == 0,
          "an array has changed");
    b->batch = batch;
}

/* The same for a batch that is wrong whatever the input. */
static void check_batch_refused(bench *b, int expected, const char *what)
{
    check_refused(b, expected, b->data, sizeof b->data, what);
    check(canser_decoder_flush(&b->decoder, &b->batch) == expected, "flush returns another status");
    check(b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the counts are not set by flush");
    check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0,
          "the decoder has changed in flush");
    set_bench(b);
}

static void test_batch_arguments(bench *b)
{
    b->batch.frames = NULL;
    check_batch_refused(b, CANSER_NULL, "frames NULL");

    b->batch.frames = behind(b->memory.frames, 1);
    b->batch.frame_cap = 2;
    check_batch_refused(b, CANSER_MISALIGNED, "frames misaligned");
    b->batch.offsets = behind(b->offsets, 1);
    check_batch_refused(b, CANSER_MISALIGNED, "offsets misaligned");
    b->batch.ends = behind(b->ends, 1);
    b->batch.frame_cap = 2;
    check_batch_refused(b, CANSER_MISALIGNED, "ends misaligned");
    b->batch.controls = behind(b->controls, 1);
    b->batch.control_cap = 2;
    check_batch_refused(b, CANSER_MISALIGNED, "controls misaligned");

    b->batch.offsets = behind(b->memory.frames, sizeof b->memory - 8);
    check_batch_refused(b, CANSER_OVERLAP, "offsets on frames");
    b->batch.ends = behind(b->memory.frames, sizeof b->memory - 8);
    check_batch_refused(b, CANSER_OVERLAP, "ends on frames");
    b->batch.ends = b->offsets;
    check_batch_refused(b, CANSER_OVERLAP, "ends on offsets");
    b->batch.controls = behind(b->ends, 24);
    check_batch_refused(b, CANSER_OVERLAP, "controls on ends");
    b->batch.controls = behind(b->memory.frames, sizeof b->memory - 8);
    check_batch_refused(b, CANSER_OVERLAP, "controls on frames");
    b->batch.controls = behind(b->offsets, 24);
    check_batch_refused(b, CANSER_OVERLAP, "controls on offsets");
}

static void test_input_arguments(bench *b)
{
    check_refused(b, CANSER_NULL, NULL, 1, "data NULL");
    check_refused(b, CANSER_OVERLAP, behind(b->memory.bytes, sizeof b->memory - 1), 1,
                  "data on frames");
    check_refused(b, CANSER_OVERLAP, behind(b->offsets, 0), 1, "data on offsets");
    check_refused(b, CANSER_OVERLAP, behind(b->ends, 31), 1, "data on ends");
    check_refused(b, CANSER_OVERLAP, behind(b->controls, 5), 3, "data on controls");

    now.part = "self, batch or used NULL";
    b->used = SIZE_MAX;
    check(canser_decoder_feed(NULL, b->data, 1, &b->batch, &b->used) == CANSER_NULL, "self");
    check(b->used == 0 && b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the results are not set where self is NULL");
    b->used = SIZE_MAX;
    check(canser_decoder_feed(&b->decoder, b->data, 1, NULL, &b->used) == CANSER_NULL, "batch");
    check(b->used == 0, "*used is not set where batch is NULL");
    b->batch.frame_count = b->batch.control_count = SIZE_MAX;
    check(canser_decoder_feed(&b->decoder, b->data, 1, &b->batch, NULL) == CANSER_NULL, "used");
    check(b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the counts are not set where used is NULL");
    b->batch.frame_count = b->batch.control_count = SIZE_MAX;
    check(canser_decoder_flush(NULL, &b->batch) == CANSER_NULL, "flush: self");
    check(b->batch.frame_count == 0 && b->batch.control_count == 0,
          "the counts are not set by flush where self is NULL");
    check(canser_decoder_flush(&b->decoder, NULL) == CANSER_NULL, "flush: batch");
    check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0, "the decoder has changed");
    check(canser_decoder_init(NULL, b->decoder.protocol, 1) == CANSER_NULL, "init: self");
    check(canser_decoder_init(&b->decoder, NULL, 1) == CANSER_NULL, "init: protocol");
    check(canser_decoder_init(&b->decoder, b->decoder.protocol, 0) == CANSER_TICK, "init: tick 0");
    check(canser_decoder_init(&b->decoder, b->decoder.protocol, -1) == CANSER_TICK,
          "init: tick below 0");
    set_bench(b);
}

/* What looks like a mistake and is none. */
static void test_good_arguments(bench *b)
{
    now.part = "no bytes";
    check(canser_decoder_feed(&b->decoder, NULL, 0, &b->batch, &b->used) == CANSER_OK, "status");
    check(b->used == 0 && b->batch.frame_count == 0 && b->batch.control_count == 0, "results");
    check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0, "the decoder has changed");

    now.part = "frame_cap 0";
    for (int i = 0; i < 2; i++) {
        set_bench(b);
        b->batch.frame_cap = 0;
        b->batch.frames = i ? NULL : b->batch.frames;
        check(canser_decoder_feed(&b->decoder, b->data, 64, &b->batch, &b->used) == CANSER_OK,
              "status");
        check(b->used == 0 && b->batch.frame_count == 0 && b->batch.control_count == 0, "results");
        check(canser_decoder_flush(&b->decoder, &b->batch) == CANSER_OK, "flush: status");
        check(b->batch.frame_count == 0 && b->batch.control_count == 0, "flush: results");
        check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0, "something was taken");
    }

    /* Arrays that touch do not overlap. */
    now.part = "arrays that touch";
    static union {
        canser_control aligned;
        uint8_t
            bytes[4 * (sizeof(canser_frame) + 2 * sizeof(int64_t) + sizeof(canser_control)) + 64];
    } all;
    set_bench(b);
    b->batch.frames = behind(&all, 0);
    b->batch.offsets = behind(&all, 4 * sizeof(canser_frame));
    b->batch.ends = behind(&all, 4 * (sizeof(canser_frame) + sizeof(int64_t)));
    b->batch.controls = behind(&all, 4 * (sizeof(canser_frame) + 2 * sizeof(int64_t)));
    check(canser_decoder_feed(&b->decoder, all.bytes + sizeof all - 64, 64, &b->batch, &b->used) ==
              CANSER_OK,
          "status");
    set_bench(b);
}

/* A control packet that has no room is not lost: the scan waits before it. */
static void test_full_controls(void)
{
    static const uint8_t pings[] = {0xFF, 0xFF, 0x00, 0xFF, 0xFF, 0x00, 0x12, 0x30};
    canser_decoder decoder;
    canser_frame frame;
    canser_control control;
    canser_batch batch = {.frames = &frame, .frame_cap = 1, .controls = &control};
    size_t used = 0;

    now.part = "control_cap 0";
    now.protocol = PLAIN_cantalope;
    canser_decoder_init(&decoder, canser_protocol_at(PLAIN_cantalope), 1);
    check(canser_decoder_feed(&decoder, pings, sizeof pings, &batch, &used) == CANSER_OK, "status");
    check(used == 0 && batch.control_count == 0 && batch.frame_count == 0, "something was taken");
    for (size_t i = 0; i < 2; i++) {
        batch.control_cap = 1;
        check(canser_decoder_feed(&decoder, pings + 3 * i, sizeof pings - 3 * i, &batch, &used) ==
                  CANSER_OK,
              "status");
        check(batch.control_count == 1 && control.offset == 3 * i && control.len == 3,
              "the control packet is lost");
        check(used == (i ? 5 : 3) && batch.frame_count == i, "the scan does not stop before it");
    }

    now.part = "controls NULL";
    batch.controls = NULL;
    canser_decoder_init(&decoder, canser_protocol_at(PLAIN_cantalope), 1);
    check(canser_decoder_feed(&decoder, pings, sizeof pings, &batch, &used) == CANSER_OK, "status");
    check(used == sizeof pings && batch.control_count == 0 && batch.frame_count == 1,
          "the scan waits where control packets are not asked for");
    check(decoder.stats.controls == 2, "control packets are not counted");
}

static void test_encode_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    canser_frame frames[3];
    uint8_t out[3 * CANSER_PACKET_MAX];
    canser_encoded result;

    memset(out, 0x5A, sizeof out);
    for (size_t i = 0; i < 2; i++)
        frames[i] = random_frame(now.protocol);

    const struct {
        const char *what;
        int status;
        const canser_protocol *protocol;
        const canser_frame *frames;
        size_t frame_count;
        uint8_t *out;
        size_t out_cap;
    } calls[] = {
        {"encode: protocol NULL", CANSER_NULL, NULL, frames, 2, out, sizeof out},
        {"encode: frames NULL", CANSER_NULL, protocol, NULL, 1, out, sizeof out},
        {"encode: out NULL", CANSER_NULL, protocol, frames, 2, NULL, 1},
        {"encode: misaligned", CANSER_MISALIGNED, protocol, behind(frames, 1), 2, out, sizeof out},
        {"encode: out on frames", CANSER_OVERLAP, protocol, frames, 2, behind(frames, 47), 20},
        {"encode: frames on out", CANSER_OVERLAP, protocol, frames + 1, 2, behind(frames, 0), 25},
        {"encode: no frames", CANSER_OK, protocol, NULL, 0, out, sizeof out},
        {"encode: no room", CANSER_OK, protocol, frames, 2, NULL, 0},
    };
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        now.part = calls[i].what;
        result = (canser_encoded){SIZE_MAX, SIZE_MAX, -1};
        check(canser_encode(calls[i].protocol, 1000, calls[i].frames, calls[i].frame_count,
                            calls[i].out, calls[i].out_cap, &result) == calls[i].status,
              "another status");
        check(result.frame_count == 0 && result.byte_count == 0 &&
                  result.refusal == CANSER_REFUSAL_NONE,
              "the results are not set");
        check(is_filled(out, sizeof out, 0x5A), "out was written");
    }
    now.part = "encode: tick below 1";
    for (int64_t tick_ns = -1; tick_ns < 1; tick_ns++) {
        result = (canser_encoded){SIZE_MAX, SIZE_MAX, -1};
        check(canser_encode(protocol, tick_ns, frames, 2, out, sizeof out, &result) == CANSER_TICK,
              "another status");
        check(result.frame_count == 0 && result.byte_count == 0 &&
                  result.refusal == CANSER_REFUSAL_NONE,
              "the results are not set");
        check(is_filled(out, sizeof out, 0x5A), "out was written");
    }
    now.part = "encode: result NULL";
    check(canser_encode(protocol, 1000, frames, 2, out, sizeof out, NULL) == CANSER_NULL,
          "another status");
    check(is_filled(out, sizeof out, 0x5A), "out was written");

    now.part = "encode: out that touches";
    check(canser_encode(protocol, 1000, frames, 2, behind(frames, 48), 20, &result) == CANSER_OK,
          "another status");
}

static void test_refuse_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    canser_frame frames[3];
    uint8_t refusals[3];

    memset(refusals, 0x5A, sizeof refusals);
    for (size_t i = 0; i < 2; i++)
        frames[i] = random_frame(now.protocol);

    const struct {
        const char *what;
        int status;
        const canser_protocol *protocol;
        const canser_frame *frames;
        size_t frame_count;
        uint8_t *refusals;
    } calls[] = {
        {"refuse: protocol NULL", CANSER_NULL, NULL, frames, 2, refusals},
        {"refuse: frames NULL", CANSER_NULL, protocol, NULL, 1, refusals},
        {"refuse: refusals NULL", CANSER_NULL, protocol, frames, 2, NULL},
        {"refuse: misaligned", CANSER_MISALIGNED, protocol, behind(frames, 1), 2, refusals},
        {"refuse: refusals on frames", CANSER_OVERLAP, protocol, frames, 2, behind(frames, 47)},
        {"refuse: no frames", CANSER_OK, protocol, NULL, 0, NULL},
    };
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        now.part = calls[i].what;
        check(canser_refuse(calls[i].protocol, calls[i].frames, calls[i].frame_count,
                            calls[i].refusals) == calls[i].status,
              "another status");
        check(is_filled(refusals, sizeof refusals, 0x5A), "refusals was written");
    }
}

static void test_adapter_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    const canser_config config = {.bitrate = 500000};
    const uint8_t byte = 0xFF;
    canser_packet packet;
    canser_report report;

    now.part = "configure: NULL";
    memset(&packet, 0x5A, sizeof packet);
    check(canser_configure(NULL, &config, &packet) == CANSER_NULL, "another status");
    check(is_filled(&packet, sizeof packet, 0), "the packet is not set");
    memset(&packet, 0x5A, sizeof packet);
    check(canser_configure(protocol, NULL, &packet) == CANSER_NULL, "another status");
    check(is_filled(&packet, sizeof packet, 0), "the packet is not set");
    check(canser_configure(protocol, &config, NULL) == CANSER_NULL, "another status");

    now.part = "explain: NULL";
    memset(&report, 0x5A, sizeof report);
    check(canser_explain(NULL, &byte, 1, &report) == CANSER_NULL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
    memset(&report, 0x5A, sizeof report);
    check(canser_explain(protocol, NULL, 1, &report) == CANSER_NULL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
    check(canser_explain(protocol, &byte, 1, NULL) == CANSER_NULL, "another status");

    now.part = "explain: no bytes";
    memset(&report, 0x5A, sizeof report);
    check(canser_explain(protocol, NULL, 0, &report) == CANSER_NO_CONTROL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
}

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
    check(memcmp(&b->memory, &before.memory, sizeof b->memory) == 0 &&
              memcmp(b->offsets, before.offsets, sizeof b->offsets) == 0 &&
              memcmp(b->ends, before.ends, sizeof b->ends) == 0 &&
              memcmp(b->controls, before.controls, sizeof b->controls) == 0,
          "an array has changed");
    set_bench(b);
}

static void test_chunk_arguments(bench *b)
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

static void test_join_arguments(bench *b)
{
    const size_t other = (size_t)(now.protocol + 1) % PLAIN_PROTOCOL_COUNT;
    canser_decoder decoder;
    canser_chunk chunk, before;
    canser_frame copies[4];

    now.part = "join";
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
    check(canser_decoder_join(&b->decoder, &chunk, frames) == CANSER_APART, "bytes are held");
    chunk.begin = b->decoder.stats.bytes_in;
    check(canser_decoder_join(&b->decoder, &chunk, frames) == CANSER_APART, "bytes are held");
    chunk.begin = 0;
    check(memcmp(&b->before, &b->decoder, sizeof b->before) == 0, "the decoder has changed");
    decoder.stats.bytes_in = 1;
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_APART, "another place");
    canser_decoder_init(&decoder, canser_protocol_at(other), 1000);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_APART, "another protocol");
    canser_decoder_init(&decoder, b->decoder.protocol, 999);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_APART, "another unit");
    check(memcmp(&before, &chunk, sizeof before) == 0, "the chunk has changed");
    /* A join that was refused is no harm. */
    canser_decoder_init(&decoder, b->decoder.protocol, 1000);
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_OK, "another status");
    check(canser_decoder_join(&decoder, &chunk, frames) == CANSER_APART, "joined twice");

    now.part = "deliver";
    memset(copies, 0x5A, sizeof copies);
    check(canser_chunk_deliver(NULL, frames, 0, count, copies) == CANSER_NULL, "self NULL");
    check(canser_chunk_deliver(&chunk, NULL, 0, count, copies) == CANSER_NULL, "frames NULL");
    check(canser_chunk_deliver(&chunk, frames, 0, count, NULL) == CANSER_NULL, "out NULL");
    check(canser_chunk_deliver(&chunk, NULL, 0, 0, NULL) == CANSER_OK, "no frames");
    check(canser_chunk_deliver(&chunk, frames, 1, 0, copies) == CANSER_OK, "no frames");
    check(is_filled(copies, sizeof copies, 0x5A), "out was written");
    check(canser_chunk_deliver(&chunk, frames, count - 1, 1, copies + 1) == CANSER_OK, "status");
    check(memcmp(copies[1].data, frames[count - 1].data, 8) == 0, "another frame");
    check(is_filled(copies, sizeof *copies, 0x5A) &&
              is_filled(copies + 2, 2 * sizeof *copies, 0x5A),
          "more than one frame was written");
    set_bench(b);
}

/* Bytes that are held are taken first, and go on being held if they must. */
static void test_advance(bench *b)
{
    canser_decoder fed;
    canser_frame frames[64];
    canser_batch batch = {.frames = frames, .frame_cap = 64};

    now.part = "advance";
    for (size_t stop = 0; stop <= sizeof b->data; stop++) {
        now.len = stop;
        fed = b->decoder;
        check(canser_decoder_advance(&b->decoder, b->data + 1, 63, stop, &batch, &b->used) ==
                  CANSER_OK,
              "another status");
        check(b->decoder.carry_len == 0, "bytes are held");
        check(b->used >= stop || b->used + CANSER_BEHIND > 63, "it stops without need");
        check(b->used < stop + CANSER_PACKET_MAX, "it takes what starts behind");
        const size_t count = batch.frame_count, used = b->used;
        check(canser_decoder_feed(&fed, b->data + 1, used, &batch, &b->used) == CANSER_OK, "feed");
        check(batch.frame_count == count && fed.carry_len == 0 &&
                  memcmp(&fed.stats, &b->decoder.stats, sizeof fed.stats) == 0,
              "it differs from feed");
        set_bench(b);
    }
    now.len = 0;
    check(canser_decoder_advance(&b->decoder, NULL, 0, 9, &b->batch, &b->used) == CANSER_OK &&
              b->used == 0,
          "no bytes");
    check(memcmp(&b->decoder, &b->before, sizeof b->decoder) == 0, "the decoder has changed");
    set_bench(b);
}

static void test_arguments(void)
{
    static bench b;

    now.kind = 0;
    now.len = now.shift = now.frame_cap = now.control_cap = 0;
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        now.part = "bench";
        set_bench(&b);
        test_batch_arguments(&b);
        test_input_arguments(&b);
        test_good_arguments(&b);
        test_advance(&b);
        test_chunk_arguments(&b);
        test_join_arguments(&b);
        test_encode_arguments();
        test_refuse_arguments();
        test_adapter_arguments();
    }
    test_full_controls();
    test_tables();
}

int main(int argc, char **argv)
{
    const bool huge = argc > 1 && strcmp(argv[1], "--huge") == 0;

    if (argc > 2 || (argc == 2 && !huge)) {
        fprintf(stderr, "usage: guard [--huge]\n");
        return 2;
    }
    set_up_streams();
    catch_faults();
    if (huge && sizeof(size_t) < sizeof(uint64_t)) {
        printf("skipped: an address space of 32 bits has no 4 GiB\n");
    } else if (huge) {
        test_huge();
    } else {
        test_decode();
        test_ends();
        test_chunks();
        test_chunk_clocks();
        test_chunk_chains();
        test_encode();
        test_refusals();
        test_configure();
        test_explain();
        test_row_packets();
        test_times();
        test_times_arguments();
        test_arguments();
    }
    return report_checks();
}
