/* Private: the runs of the times of a bus: see canser_runs in canser.h.
 *
 * A time continues a run if it is at most a second before the last time of the run, and not behind
 * it by more than a hole. A time that does not is a jump, and begins a run. The run before is kept
 * until RUN_SURE times have come: if one of them continues it, those between were false.
 *
 * A hole is longer than a second, and than 20 times the step that 99.9 % of all steps before it do
 * not exceed. So it is found without looking ahead, and wherever the frames are cut. */
#ifndef CANSER_RUNS_H
#define CANSER_RUNS_H

#include "protocol.h"

/* An adapter with several mailboxes reports frames out of order by milliseconds, and a log of
 * several lines by the time of a read. A longer step back is a restart, or a false time. */
#define RUN_DISORDER_NS INT64_C(1000000000)

/* The shortest hole, and how many times as long as most steps a hole is. */
#define RUN_HOLE_NS    INT64_C(1000000000)
#define RUN_HOLE_TIMES 20

/* No step up to this can make a hole longer than RUN_HOLE_NS, so these are only counted. */
#define RUN_SHORT_NS (RUN_HOLE_NS / RUN_HOLE_TIMES)

/* The first steps say little about those that follow: up to RUN_FIRST, a hole is longer than
 * RUN_FIRST_HOLE_NS. */
#define RUN_FIRST         10
#define RUN_FIRST_HOLE_NS (INT64_C(3600) * 1000000000)

/* The run of a frame without a time. */
#define RUN_NONE UINT32_MAX

/* The most false times in a row, as in the rule of the decoder (clock.h). */
#define RUN_SURE 4

/* The bin of a long step: 8 for each power of two, from the one that has RUN_SHORT_NS. */
CANSER_INLINE size_t run_bin(uint64_t step)
{
    const double value = (double)(int64_t)(step >> 1);
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    bits = (bits >> 49) - ((UINT64_C(1023) + 24) << 3);
    return bits < CANSER_RUN_BINS ? (size_t)bits : CANSER_RUN_BINS - 1;
}

/* The longest step in a bin, and one more. */
CANSER_INLINE uint64_t run_bin_end(size_t bin)
{
    return (UINT64_C(8) + (bin + 1) % 8) << (22 + (bin + 1) / 8);
}

CANSER_INLINE uint64_t run_step(int64_t from, int64_t to)
{
    return (uint64_t)to - (uint64_t)from;
}

/* The longest step that is no hole. */
CANSER_COLD uint64_t run_hole(const canser_runs *self)
{
    const uint64_t rank = self->steps - self->steps / 1000;
    uint64_t counted = self->steps - self->long_steps;
    uint64_t hole = RUN_HOLE_NS;

    if (self->steps < RUN_FIRST)
        return RUN_FIRST_HOLE_NS;
    for (size_t bin = 0; bin < CANSER_RUN_BINS && counted < rank; bin++) {
        counted += self->bins[bin];
        if (counted < rank)
            continue;
        hole = run_bin_end(bin);
        hole = hole < UINT64_MAX / RUN_HOLE_TIMES ? hole * RUN_HOLE_TIMES : UINT64_MAX;
        hole = hole < (uint64_t)RUN_HOLE_NS ? (uint64_t)RUN_HOLE_NS : hole;
    }
    return hole;
}

CANSER_INLINE bool run_continues(const canser_runs *self, int64_t last, int64_t ts)
{
    if (ts < last)
        return run_step(ts, last) <= (uint64_t)RUN_DISORDER_NS;
    return run_step(last, ts) <= (uint64_t)RUN_HOLE_NS || run_step(last, ts) <= run_hole(self);
}

CANSER_INLINE void run_count_step(canser_runs *self, uint64_t step)
{
    self->steps++;
    if (step > (uint64_t)RUN_SHORT_NS) {
        self->long_steps++;
        self->bins[run_bin(step)]++;
    }
}

/* Go on to a time that continues a run, whose last time is `last`. */
CANSER_INLINE void run_continue(canser_runs *self, int64_t last, int64_t ts)
{
    uint64_t step = ts < last ? run_step(ts, last) : run_step(last, ts);

    run_count_step(self, ts < last ? 0 : step);
    self->last = ts;
    if (self->unit_steps < CANSER_UNIT_STEPS) {
        self->unit_steps++;
        while (self->unit) { /* the greatest common divisor */
            const uint64_t rest = step % self->unit;
            step = self->unit;
            self->unit = rest;
        }
        self->unit = step;
    }
}

CANSER_INLINE void run_begin(canser_runs *self, int64_t ts)
{
    self->run = self->last_number = self->last_number == RUN_NONE - 1 ? 1 : self->last_number + 1;
    self->last = ts;
}

/* How near a time must be for runs_next() not to be asked: see run_is_near(). No time is, if each
 * one must be asked about. Beyond 146 years from 0 none is, either: this saves a comparison with
 * CANSER_NO_TIME, and the question whether a difference fits into 64 bits. */
CANSER_INLINE uint64_t runs_near(const canser_runs *self)
{
    if (!self->run || self->since || self->unit_steps < CANSER_UNIT_STEPS ||
        self->last < INT64_MIN / 2 || self->last > INT64_MAX / 2)
        return 0;
    return (uint64_t)(RUN_DISORDER_NS + RUN_SHORT_NS);
}

CANSER_INLINE bool run_is_near(int64_t last, int64_t ts, uint64_t near)
{
    return run_step(last, ts) + (uint64_t)RUN_DISORDER_NS < near;
}

/* Return the number of the run that a time is in, 0 for none. */
CANSER_NOINLINE uint32_t runs_next(canser_runs *self, int64_t ts)
{
    if (ts == CANSER_NO_TIME)
        return 0;
    if (!self->run) {
        run_begin(self, ts);
        return self->run;
    }
    if (self->since && run_continues(self, self->last_before, ts)) {
        self->run = self->run_before;
        self->since = 0;
        run_continue(self, self->last_before, ts);
        return self->run;
    }
    if (self->since && ++self->since > RUN_SURE) {
        self->since = 0;
        if (self->jump)
            run_count_step(self, self->jump);
    }
    if (run_continues(self, self->last, ts)) {
        run_continue(self, self->last, ts);
        return self->run;
    }
    if (!self->since) {
        self->last_before = self->last;
        self->run_before = self->run;
        self->jump = ts > self->last ? run_step(self->last, ts) : 0;
        self->since = 1;
    }
    run_begin(self, ts);
    return self->run;
}

#endif
