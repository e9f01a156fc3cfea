/* The times of frames by the arrivals of pieces: as plain_timing.c has them, and no memory but the
 * caller's is touched. */
#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "plain_timing.h"
#include "tests.h"

#include <string.h>

/* Times: a call has values of its own in memory against guard pages. */
enum { TIMES_MAX = 2200, TIMES_ARRAYS = 3 };

static arena times_arenas[TIMES_ARRAYS];

static void *place_times(int array, const void *values, size_t size)
{
    uint8_t *const p = arena_put(&times_arenas[array], size, 0, UNUSED_BYTE);

    if (size && values)
        memcpy(p, values, size);
    return p;
}

/* Whether the memory around an array is as it was, and the array as it must be. */
static void check_times(int array, const void *p, const void *values, size_t size)
{
    check(arena_is_clean(&times_arenas[array], p, size, UNUSED_BYTE),
          "memory around an array was written");
    check(!size || memcmp(p, values, size) == 0, "the times differ");
}

/* Pieces and, apart by 1 to 40, offsets: some of them lie behind all pieces. */
static void make_pieces(canser_piece *pieces, size_t piece_count, int64_t *at, size_t count)
{
    int64_t end = 0, ns = -1000, offset = (int64_t)random_below(3);

    for (size_t i = 0; i < piece_count; i++) {
        pieces[i].end = end += (int64_t)random_below(64);
        pieces[i].ns = ns += (int64_t)random_below(1 << 20);
    }
    for (size_t i = 0; i < count; i++)
        offset = 1 + (at[i] = offset + (int64_t)random_below(40));
}

/* Frames get their times in two calls, and with as little room for samples as there may be. */
static void check_timing(const canser_timing *setup, size_t piece_count, size_t count)
{
    static canser_piece pieces[TIMES_MAX];
    static canser_frame frames[TIMES_MAX], expected[TIMES_MAX];
    static canser_sample samples[TIMES_MAX], got[TIMES_MAX];
    static int64_t at[TIMES_MAX], arrivals[TIMES_MAX], counters[TIMES_MAX], device[TIMES_MAX];
    const int64_t tick_ns = setup->tick_ns;
    canser_timing timing = *setup;
    size_t done = 0, found = 0;

    make_pieces(pieces, piece_count, at, count);
    memset(frames, UNUSED_BYTE, sizeof frames);
    for (size_t i = 0; i < count; i++) {
        /* What the host's clock says, or near it, or false, and any turn. */
        const int64_t byte = at[i] - !tick_ns;

        arrivals[i] = plain_arrival(pieces, piece_count, setup->byte_ns, byte);
        if (!tick_ns)
            continue;
        const uint64_t drawn = random_below(4)
                                   ? (uint64_t)(arrivals[i] / tick_ns) + (random_word() & 3)
                                   : random_word() >> (21 + random_below(20));
        const uint64_t ticks = drawn + ((random_word() & 3) << 32);
        counters[i] = (int64_t)(ticks & UINT32_MAX) * tick_ns;
        frames[i].ts = plain_wrap(ticks * (uint64_t)tick_ns);
    }
    memcpy(expected, frames, sizeof expected);
    if (tick_ns) {
        plain_turns(counters, arrivals, count, tick_ns, device);
        if (!setup->keeps_device)
            found = plain_samples(pieces, piece_count, at, device, arrivals, count, samples);
    }
    if (tick_ns && setup->has_line && !setup->keeps_device)
        plain_map(setup, device, arrivals, count, expected);
    else
        for (size_t i = 0; i < count; i++)
            expected[i].ts = tick_ns && setup->keeps_device ? device[i] : arrivals[i];

    const canser_piece *const p = place_times(0, pieces, piece_count * sizeof *p);
    const int64_t *const o = place_times(1, at, count * sizeof *o);
    canser_frame *const f = place_times(2, frames, count * sizeof *f);
    canser_sample one;
    const size_t cut = random_below(count + 1);
    size_t taken = 0;
    timing.samples = &one;
    timing.sample_cap = 0;
    for (int half = 0; half < 2; half++) {
        const size_t until = half ? count : cut;

        check(canser_timing_assign(&timing, p, piece_count, o, f, until, &done) == CANSER_OK,
              "another status");
        while (timing.stopped == CANSER_TIMING_FULL) {
            check(done < until && timing.sample_count == timing.sample_cap, "full too early");
            if (timing.sample_count)
                got[taken++] = one;
            timing.sample_count = 0;
            timing.sample_cap = 1;
            check(canser_timing_assign(&timing, p, piece_count, o, f, until, &done) == CANSER_OK,
                  "another status");
        }
        check(timing.stopped == CANSER_TIMING_DONE && done == until, "not all have their times");
    }
    if (timing.sample_count)
        got[taken++] = one;
    check(taken == found && memcmp(got, samples, found * sizeof *got) == 0, "the samples differ");
    check_times(0, p, pieces, piece_count * sizeof *p);
    check_times(1, o, at, count * sizeof *o);
    check_times(2, f, expected, count * sizeof *f);
}

void test_times(void)
{
    static const int64_t units[] = {0, 1, 7, 1000, 1000000, 1000000000, 1 << 20};
    static const double byte_ns[] = {0, 86805.5, CANSER_BYTE_NS_MAX};

    begin_part("times");
    for (int i = 0; i < TIMES_ARRAYS; i++)
        times_arenas[i] = arena_new(TIMES_MAX * sizeof(canser_frame));
    for (size_t round = 0; round < 1000; round++) {
        const size_t count = round < 60 ? round : random_below(random_below(8) ? 60 : TIMES_MAX);
        const int64_t line_at = (int64_t)random_below(1 << 24);
        const canser_timing setup = {
            .tick_ns = units[random_below(7)],
            .keeps_device = random_below(3) == 0,
            .silence_ns = INT64_MAX,
            .bucket_ns = INT64_MAX,
            .bucket_most = SIZE_MAX,
            .byte_ns = byte_ns[random_below(3)],
            .line = {line_at, line_at + (int64_t)random_below(1 << 24) - (1 << 23),
                     random_below(3) ? (double)random_below(2001) / 1e6 - 1e-3 : -0.999},
            .has_line = random_below(4) != 0,
            .trust = {line_at - (random_below(2) ? 0 : INT64_C(1) << 40),
                      (int64_t)random_below(1 << 22), (int64_t)random_below(1 << 24)},
        };

        now.kind = (int)(round % 5);
        now.at_end = round % 2;
        now.len = count;
        check_timing(&setup, 1 + random_below(60), count);
    }
}
