/* The caller's mistakes in calls of canser_decoder_feed(), _advance(), _flush() and _init(), what
 * looks like one and is none, and a batch without room. */
#include "arena.h"
#include "bench.h"
#include "checks.h"
#include "plain.h"
#include "tests.h"

#include <string.h>

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
    check_arrays_kept(b, &before);
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

static void check_batch_arguments(bench *b)
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

static void check_input_arguments(bench *b)
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
static void check_good_arguments(bench *b)
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

void test_decoder_arguments(void)
{
    static bench b;

    begin_part("decoder: arguments");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        set_bench(&b);
        check_batch_arguments(&b);
        check_input_arguments(&b);
        check_good_arguments(&b);
    }
}

/* Bytes that are held are taken first, and go on being held if they must. */
static void check_advance(bench *b)
{
    canser_decoder fed;
    canser_frame frames[64];
    canser_batch batch = {.frames = frames, .frame_cap = 64};

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

void test_advance(void)
{
    static bench b;

    begin_part("advance");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        set_bench(&b);
        check_advance(&b);
    }
}

/* A control packet that has no room is not lost: the scan waits before it. */
void test_full_controls(void)
{
    static const uint8_t pings[] = {0xFF, 0xFF, 0x00, 0xFF, 0xFF, 0x00, 0x12, 0x30};
    canser_decoder decoder;
    canser_frame frame;
    canser_control control;
    canser_batch batch = {.frames = &frame, .frame_cap = 1, .controls = &control};
    size_t used = 0;

    begin_part("control_cap 0");
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
