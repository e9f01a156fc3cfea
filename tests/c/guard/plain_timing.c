#include "plain_timing.h"

#include <stdbool.h>

int64_t plain_wrap(uint64_t value)
{
    return value > INT64_MAX ? -(int64_t)(UINT64_MAX - value) - 1 : (int64_t)value;
}

static int64_t less(int64_t a, int64_t b)
{
    return plain_wrap((uint64_t)a - (uint64_t)b);
}

/* The piece that the byte at an offset came with. */
static size_t piece_of(const canser_piece *pieces, size_t piece_count, int64_t at)
{
    size_t k = 0;

    while (k < piece_count - 1 && pieces[k].end <= at)
        k++;
    return k;
}

int64_t plain_arrival(const canser_piece *pieces, size_t piece_count, double byte_ns, int64_t at)
{
    const size_t k = piece_of(pieces, piece_count, at);
    const int64_t more = pieces[k].end > at ? pieces[k].end - at - 1 : 0;
    const int64_t arrival = pieces[k].ns - (int64_t)((double)more * byte_ns);

    return k && arrival < pieces[k - 1].ns ? pieces[k - 1].ns : arrival;
}

/* The time nearest to `expected` at which a counter shows what it does at `counter`. */
static int64_t plain_turn(int64_t counter, int64_t expected, int64_t turn_ns)
{
    int64_t rest = (expected - counter) % turn_ns;

    rest += rest < 0 ? turn_ns : 0;
    return expected - rest + (rest > turn_ns / 2 ? turn_ns : 0);
}

static bool plain_near(int64_t a, int64_t b, int64_t tick_ns)
{
    return (a > b ? a - b : b - a) <= tick_ns << 24;
}

void plain_turns(const int64_t *counters, const int64_t *arrivals, size_t count, int64_t tick_ns,
                 int64_t *device)
{
    const int64_t turn_ns = tick_ns << 32;
    int64_t known = 0, last = 0;
    int run = 0;

    for (size_t i = 0; i < count; i++) {
        const int64_t expected = arrivals[i] - known, follows = arrivals[i] - last;

        device[i] = i ? plain_turn(counters[i], expected, turn_ns) : counters[i];
        if (!i || plain_near(device[i], expected, tick_ns)) {
            known = arrivals[i] - device[i];
            run = 0;
            continue;
        }
        const int64_t next = plain_turn(counters[i], follows, turn_ns);
        const bool goes_on = run && plain_near(next, follows, tick_ns);

        device[i] = goes_on ? next : device[i];
        run = goes_on ? run + 1 : 1;
        last = arrivals[i] - device[i];
        if (run == 16) {
            known = last;
            run = 0;
        }
    }
}

/* The lowest of a piece, but for two at most that are lower than the next one by over a minute. */
static canser_sample plain_sample(const int64_t *device, const int64_t *arrivals, size_t begin,
                                  size_t end)
{
    size_t sorted[3], found = 0, chosen = 0;

    while (found < 3 && found < end - begin) {
        size_t lowest = SIZE_MAX;

        for (size_t i = begin; i < end; i++) {
            bool taken = false;

            for (size_t k = 0; k < found; k++)
                taken |= sorted[k] == i;
            if (!taken && (lowest == SIZE_MAX ||
                           less(arrivals[i], device[i]) < less(arrivals[lowest], device[lowest])))
                lowest = i;
        }
        sorted[found++] = lowest;
    }
    while (chosen + 1 < found) {
        const size_t i = sorted[chosen], k = sorted[chosen + 1];

        if (less(less(arrivals[k], device[k]), less(arrivals[i], device[i])) <= 60000000000)
            break;
        chosen++;
    }
    const size_t i = sorted[chosen];
    return (canser_sample){device[i], arrivals[i], less(arrivals[end - 1], arrivals[i])};
}

size_t plain_samples(const canser_piece *pieces, size_t piece_count, const int64_t *at,
                     const int64_t *device, const int64_t *arrivals, size_t count,
                     canser_sample *samples)
{
    size_t found = 0, begin = 0;

    for (size_t i = 1; i < count; i++) {
        /* By the end: a piece of no bytes is none. */
        if (pieces[piece_of(pieces, piece_count, at[i])].end ==
            pieces[piece_of(pieces, piece_count, at[i - 1])].end)
            continue;
        samples[found++] = plain_sample(device, arrivals, begin, i);
        begin = i;
    }
    return found;
}

void plain_map(const canser_timing *timing, const int64_t *device, const int64_t *arrivals,
               size_t count, canser_frame *frames)
{
    const canser_line line = timing->line;
    const canser_trust trust = timing->trust;
    int64_t held = 0;

    for (size_t i = 0; i < count; i++) {
        const int64_t run = less(device[i], line.device);
        const int64_t drifted = (int64_t)((double)run * line.drift);
        const int64_t time = plain_wrap((uint64_t)run + (uint64_t)drifted + (uint64_t)line.host);
        const int64_t late = less(arrivals[i], time);

        frames[i].ts = arrivals[i];
        if (late < -trust.early || late > trust.late ||
            less(device[i], trust.reached) < -trust.early)
            continue;
        const int64_t possible = time < arrivals[i] ? time : arrivals[i];
        held = possible > held ? possible : held;
        frames[i].ts = held;
    }
}
