/* Private: the device clock, a counter of 32 bits unwrapped over the stream.
 *
 * Each frame adds the signed difference (int32)(raw - previous raw). So a wrap is a
 * step forward, and the next good time corrects a false one out of noise.
 *
 * There are two exceptions. Half a turn has no sign: a counter whose top bit is flipped
 * goes half a turn away and half a turn back, and both read as steps back. And two false
 * times in a row can go round the circle in three steps. All times after that would be a
 * whole turn off, 49.7 days of milliseconds. So the last value of a clock that ran in line
 * is kept, and one of the next few frames that is near this value is measured from it,
 * whatever came between.
 */
#ifndef CANSER_CLOCK_H
#define CANSER_CLOCK_H

#include "protocol.h"

/* The most ticks of a small step: 16.8 s of microseconds, 4.7 hours of milliseconds. Of the
 * steps that noise makes, 1 in 128 is as small. */
#define SMALL_STEP (INT32_C(1) << 24)

/* A clock runs in line after this many small steps forward in a row. Noise does not make
 * them (each has a chance of 1 in 256), and device clocks do almost always. */
enum { IN_LINE = 16 };

/* The most frames after which a frame near the line is still measured from it: noise hardly
 * makes more than three false frames in a row. Later, such a frame may really have come a
 * whole turn later. */
enum { LINE_REACH = 4 };

/* Handle a step that is not small and forward: the first frame, a wrap, a step back, a long
 * silence, a false time. Sets `turned` for the frame. */
CANSER_COLD void clock_jump(canser_clock *clock, uint32_t raw, uint64_t number, canser_stats *stats)
{
    if (number == 0)
        return;
    const uint64_t before = clock->turned + clock->raw;
    const bool in_line = clock->near_line || number - 1 - clock->jump_at >= IN_LINE;
    if (in_line) {
        clock->line = before;
        clock->line_at = number - 1;
        clock->has_line = 1;
    }
    uint64_t ticks = before + (uint64_t)(int64_t)(int32_t)(raw - clock->raw);
    clock->near_line = 0;
    if (clock->has_line && number - clock->line_at <= LINE_REACH) {
        const int32_t from_line = (int32_t)(raw - (uint32_t)clock->line);

        if (from_line >= -SMALL_STEP && from_line <= SMALL_STEP) {
            ticks = clock->line + (uint64_t)(int64_t)from_line;
            clock->near_line = 1;
        }
    }
    const bool back = (int64_t)(ticks - before) < 0;
    stats->ts_backsteps += back;
    stats->ts_uncertain += in_line && (int64_t)(ticks - before) < -SMALL_STEP;
    stats->ts_wraps += !back && raw < clock->raw;
    clock->turned = ticks - raw;
    clock->jump_at = number;
}

/* Whether the clock goes on by a small step forward. One test covers all rare cases: as an
 * unsigned number a step back is large. */
CANSER_INLINE bool clock_is_small_step(uint64_t before, uint64_t raw)
{
    return raw - before <= SMALL_STEP;
}

/* Advance the clock to frame `number` of the stream; return its time in nanoseconds, modulo 2^64.
 */
CANSER_INLINE int64_t clock_advance(canser_clock *clock, uint32_t raw, uint64_t number,
                                    canser_stats *stats)
{
    if (!CANSER_LIKELY(clock_is_small_step(clock->raw, raw)))
        clock_jump(clock, raw, number, stats);
    clock->raw = raw;
    return (int64_t)((clock->turned + raw) * (uint64_t)clock->tick_ns);
}

#endif
