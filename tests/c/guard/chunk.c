/* Streams with a chunk in them, decoded from a guess and joined: what comes out is as if there
 * were no chunk. */
#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "streams.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

/* A stretch of a stream and what is known of it: [first..stop) is to be decoded, and
 * the caller sees [begin..end). All are stream offsets. */
typedef struct {
    size_t begin, first, stop, end;
} stretch;

/* How many chunks were joined, and were not: else nothing would be tested. */
static size_t joined_count, apart_count;

/* Decode the stretch into the arrays of the arenas. Returns whether a call with these
 * arguments was good and all around it is as it was. */
static bool decode_chunk(canser_chunk *chunk, canser_batch *batch, const uint8_t *stream,
                         const stretch *at)
{
    const size_t seen = at->end - at->begin;
    const size_t frame_cap = now.frame_cap, control_cap = now.control_cap;
    uint8_t *const input = place(DRIVE_INPUT, seen);
    canser_frame *const frames = place(DRIVE_FRAMES, frame_cap * sizeof *frames);
    int64_t *const offsets = place(DRIVE_OFFSETS, frame_cap * sizeof *offsets);
    int64_t *const ends = place(DRIVE_ENDS, frame_cap * sizeof *ends);
    canser_control *const controls = place(DRIVE_CONTROLS, control_cap * sizeof *controls);

    memset(chunk, 0xA5, sizeof *chunk);
    if (seen)
        memcpy(input, stream + at->begin, seen);
    *batch = (canser_batch){.frames = frames,
                            .frame_cap = frame_cap,
                            .offsets = driven.no_offsets ? NULL : offsets,
                            .ends = driven.no_ends ? NULL : ends,
                            .controls = driven.no_controls ? NULL : controls,
                            .control_cap = control_cap,
                            .frame_count = SIZE_MAX,
                            .control_count = SIZE_MAX};
    const int status = canser_chunk_decode(chunk, canser_protocol_at((size_t)now.protocol),
                                           ended_stream.tick_ns, input, seen, at->first - at->begin,
                                           at->stop - at->begin, at->begin, batch);
    check(status == CANSER_OK, "the status of a chunk is not OK");
    check(batch->frame_count <= frame_cap, "frame_count is over frame_cap");
    check(batch->control_count <= (batch->controls ? control_cap : 0),
          "control_count is over control_cap");
    check(!seen || memcmp(input, stream + at->begin, seen) == 0, "the input was written to");
    drop(DRIVE_INPUT, input, seen);
    drop(DRIVE_FRAMES, frames, frame_cap * sizeof *frames);
    drop(DRIVE_OFFSETS, offsets, frame_cap * sizeof *offsets);
    drop(DRIVE_ENDS, ends, frame_cap * sizeof *ends);
    drop(DRIVE_CONTROLS, controls, control_cap * sizeof *controls);
    check(chunk->frame_count == batch->frame_count, "the chunk has other frames than the batch");
    check(chunk->begin <= chunk->end && chunk->end <= at->end, "a chunk ends where it may not");
    /* What starts near the end of what is seen is not decided; else all up to the first is. */
    check(chunk->begin >= at->first || chunk->begin + CANSER_BEHIND > at->end,
          "a chunk begins before its stretch");
    check(chunk->begin < at->stop || chunk->end == chunk->begin,
          "a chunk begins behind its stretch");
    const size_t frame_count = batch->frame_count, control_count = batch->control_count;
    check(
        (!batch->offsets || !frame_count || (uint64_t)batch->offsets[frame_count - 1] < at->stop) &&
            (!control_count || batch->controls[control_count - 1].offset < at->stop) &&
            (!chunk->decoder.stats.bytes_skipped || chunk->decoder.skip_end <= at->stop),
        "a chunk takes what starts behind its stretch");
    return status == CANSER_OK;
}

/* Join the chunk, if it begins where the stream stands, and append what it has found. */
static void join_chunk(canser_chunk *chunk, canser_batch *batch, bool sees_all)
{
    const bool meets = driven.decoder.stats.bytes_in == chunk->begin;
    const canser_decoder before = driven.decoder;
    const canser_chunk chunk_before = *chunk;
    const size_t count = batch->frame_count;
    canser_frame *const rows_at = driven.frames + driven.frame_count;
    const int status = canser_decoder_join(&driven.decoder, chunk, batch->frames);

    /* A clock that leaps all the time may keep a long chunk from being joined. */
    const bool settles = chunk->frame_count <= CANSER_SETTLE_MAX || status == CANSER_OK;
    check(status == (meets && settles ? CANSER_OK : CANSER_MISMATCH),
          "the status of a join differs");
    check(meets || !sees_all, "a guess that has seen all is wrong");
    joined_count += status == CANSER_OK;
    apart_count += status != CANSER_OK;
    if (status != CANSER_OK) {
        check(memcmp(&before, &driven.decoder, sizeof before) == 0 &&
                  memcmp(&chunk_before, chunk, sizeof *chunk) == 0,
              "a join that is refused changes something");
        return;
    }
    /* In two parts, and each of them once where it lies already. */
    const size_t half = random_below(count + 1);
    const bool in_place = random_below(2);
    check(canser_chunk_deliver(chunk, batch->frames, half, count - half,
                               in_place ? batch->frames + half : rows_at + half) == CANSER_OK &&
              canser_chunk_deliver(chunk, batch->frames, 0, half,
                                   in_place ? batch->frames : rows_at) == CANSER_OK,
          "the status of deliver is not OK");
    if (in_place && count)
        memcpy(rows_at, batch->frames, count * sizeof *rows_at);
    if (batch->offsets && count)
        memcpy(driven.offsets + driven.frame_count, batch->offsets, count * sizeof(int64_t));
    if (batch->ends && count)
        memcpy(driven.ends + driven.frame_count, batch->ends, count * sizeof(int64_t));
    if (batch->controls && batch->control_count)
        memcpy(driven.controls + driven.control_count, batch->controls,
               batch->control_count * sizeof(canser_control));
    driven.frame_count += count;
    driven.control_count += batch->control_count;
}

/* Go on with what starts before `stop`, as a caller does between two chunks. */
static void advance_to(const uint8_t *stream, size_t len, size_t stop)
{
    size_t used;

    do {
        const size_t pos = (size_t)driven.decoder.stats.bytes_in;
        uint8_t *const input = place(DRIVE_INPUT, len - pos);
        canser_batch batch = {.frames = driven.frames + driven.frame_count,
                              .frame_cap = 3,
                              .offsets = driven.offsets + driven.frame_count,
                              .ends = driven.ends + driven.frame_count,
                              .controls = driven.controls + driven.control_count,
                              .control_cap = 2};

        if (len > pos)
            memcpy(input, stream + pos, len - pos);
        used = SIZE_MAX;
        check(canser_decoder_advance(&driven.decoder, input, len - pos, stop > pos ? stop - pos : 0,
                                     &batch, &used) == CANSER_OK,
              "the status of advance is not OK");
        check(used <= len - pos && driven.decoder.stats.bytes_in == pos + used,
              "used is not what was taken");
        check(stop > pos || used == 0, "advance takes what starts behind its stop");
        check(driven.decoder.carry_len == 0, "advance holds bytes");
        check(used || stop <= pos || len - pos < CANSER_BEHIND, "advance stops without need");
        drop(DRIVE_INPUT, input, len - pos);
        driven.frame_count += batch.frame_count;
        driven.control_count += batch.control_count;
    } while (used);
}

/* A stream with a chunk in it: up to the border byte by byte, then the chunk, and the
 * rest; all as if there were none. */
static void check_chunk(const uint8_t *stream, size_t len, const stretch *at)
{
    canser_chunk chunk;
    canser_batch batch;

    drive_begin(&driven, now.protocol, ended_stream.tick_ns);
    advance_to(stream, len, at->first);
    if (!decode_chunk(&chunk, &batch, stream, at))
        return;
    join_chunk(&chunk, &batch, at->begin == 0 && at->end == len);
    const size_t pos = (size_t)driven.decoder.stats.bytes_in;
    if (driven.no_controls)
        driven.control_count = (size_t)driven.decoder.stats.controls;
    drive_feed(&driven, stream + pos, len - pos, len + 1, len + 1);
    drive_flush(&driven, len + 1, len + 1);
    const char *const what = drive_compare(&driven, &ended_stream);
    check(!what, what);
}

/* Every border in short streams; guesses that see all, and that see hardly anything. */
void test_chunks(void)
{
    uint8_t stream[LEN_MAX];

    begin_part("chunks");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        joined_count = apart_count = 0;
        for (now.kind = 0; now.kind < KIND_COUNT; now.kind++) {
            for (size_t len = 0; len <= LEN_MAX; len += 1 + len / 8) {
                make_stream(now.protocol, now.kind, stream, len);
                expect_streams(stream, len, 1000);
                for (size_t first = 0; first <= len; first++) {
                    const size_t stop = first + random_below(len - first + 1);
                    const stretch all = {0, first, len, len};
                    const stretch some = {random_below(first + 1), first, stop,
                                          stop + random_below(len - stop + 1)};
                    const stretch blind = {first, first, stop, len};

                    now.at_end = first % 2;
                    now.shift = random_below(SHIFT_MAX + 1);
                    driven.no_offsets = random_below(8) == 0;
                    driven.no_ends = random_below(8) == 0;
                    now.frame_cap = now.control_cap = ROW_CAP;
                    check_chunk(stream, len, &all);
                    now.frame_cap = 1 + random_below(4);
                    now.control_cap = 1 + random_below(4);
                    check_chunk(stream, len, &all);
                    check_chunk(stream, len, &some);
                    check_chunk(stream, len, &blind);
                    driven.no_offsets = driven.no_ends = false;
                }
            }
        }
        check(joined_count > 1000, "few chunks were joined");
        check(apart_count > 100, "few guesses were wrong");
    }
}

/* A stream of frames that are nothing but their times. */
enum { TIMED_LEN = 11, TIMED_MAX = ROW_CAP - 1 };

static size_t make_timed(uint8_t *stream, uint32_t raw, const int64_t *steps, size_t step_count)
{
    size_t pos = 0;

    for (size_t i = 0; i <= step_count; i++) {
        memset(stream + pos, 0, TIMED_LEN);
        stream[pos] = 0xAA;
        for (size_t k = 0; k < 4; k++)
            stream[pos + 1 + k] = (uint8_t)(raw >> 8 * k);
        stream[pos + TIMED_LEN - 1] = 0xBB;
        pos += TIMED_LEN;
        if (i < step_count)
            raw += (uint32_t)(uint64_t)steps[i];
    }
    return pos;
}

static size_t small_steps(int64_t *steps, size_t count)
{
    for (size_t i = 0; i < count; i++)
        steps[i] = (int64_t)i % 3;
    return count;
}

/* A chunk that begins at frame `border` of a stream of times. */
static void check_timed(const uint8_t *stream, size_t len, size_t border, size_t stop)
{
    const stretch at = {0, border * TIMED_LEN, stop * TIMED_LEN, len};

    now.shift = border;
    now.frame_cap = now.control_cap = ROW_CAP;
    check_chunk(stream, len, &at);
}

/* One jump so many frames before the border, one so many behind it, and a way back near
 * to where the clock stood so many frames later. */
void test_chunk_clocks(void)
{
    static const int64_t half = INT64_C(1) << 31, small = INT64_C(1) << 24;
    const int64_t jumps[] = {half, half / 2, small + 1, small, -1, -small - 1, 3 * half / 2};
    const int64_t nears[] = {0, 1, -1, small, small + 1, -small, -small - 1};
    static uint8_t stream[TIMED_MAX * TIMED_LEN];
    int64_t steps[TIMED_MAX];

    begin_part("chunk clocks");
    now.protocol = PLAIN_serial;
    now.at_end = true;
    for (size_t before = 0; before <= 19; before++) {
        for (size_t behind = 0; behind <= 19; behind++) {
            for (size_t round = 0; round < 60; round++) {
                const int64_t first = jumps[random_below(7)], second = jumps[random_below(7)];
                const size_t later = random_below(6);
                size_t n = small_steps(steps, random_below(2) ? 17 : random_below(5));

                /* Some leave out the first jump, some the way back. */
                if (round % 4)
                    steps[n++] = first;
                n += small_steps(steps + n, before);
                const size_t border = n;
                n += small_steps(steps + n, behind);
                int64_t away = second;
                steps[n++] = second;
                for (size_t i = 0; i < later; i++) {
                    const int64_t next = random_below(2) ? jumps[random_below(7)] : 1;
                    steps[n++] = next;
                    away += next;
                }
                steps[n++] = nears[random_below(7)] - away;
                n += small_steps(steps + n, random_below(2) ? 15 + random_below(3) : 1);
                if (n < TIMED_MAX - 1)
                    steps[n++] = random_below(2) ? half : -2;
                now.kind = (int)behind;
                const size_t len = make_timed(stream, (uint32_t)random_word(), steps, n);
                expect_streams(stream, len, round % 2 ? 1 : 1000000);
                check_timed(stream, len, border, n + 1);
                check_timed(stream, len, border + random_below(2), border + behind + 3);
                check_timed(stream, len, 0, border + 1);
            }
        }
    }
}

/* Jumps anywhere, and chunk behind chunk. */
void test_chunk_chains(void)
{
    static uint8_t stream[TIMED_MAX * TIMED_LEN];
    int64_t steps[TIMED_MAX];
    canser_chunk chunk;
    canser_batch batch;

    begin_part("chunk chains");
    now.protocol = PLAIN_serial;
    now.at_end = true;
    for (size_t round = 0; round < 4000; round++) {
        size_t n = 0;

        while (n < TIMED_MAX - 20) {
            n += small_steps(steps + n, random_below(19));
            steps[n++] = (int64_t)(random_below(2) ? random_word() : random_below(8) << 29);
        }
        const size_t len = make_timed(stream, (uint32_t)random_word(), steps, n);
        expect_streams(stream, len, 1000);
        drive_begin(&driven, now.protocol, 1000);
        now.kind = (int)round;
        now.frame_cap = 1 + random_below(30);
        now.control_cap = 1;
        size_t pos = 0;
        do {
            const stretch at = {0, pos, len, len};

            if (!decode_chunk(&chunk, &batch, stream, &at))
                break;
            join_chunk(&chunk, &batch, true);
            pos = (size_t)driven.decoder.stats.bytes_in;
        } while (batch.frame_count);
        drive_feed(&driven, stream + pos, len - pos, ROW_CAP, 1);
        const char *const what = drive_compare(&driven, &ended_stream);
        check(!what, what);
    }
}
