/* Host times of frames: when their bytes had come, and what a device's clock makes of it.
 *
 * What is done for each frame, and nothing else: what the clock stands at is estimated by
 * the caller. Differences of times are taken modulo 2^64, as device times out of noise
 * may be anything.
 */
#include "clock.h"

/* No true frame of a piece is less late than the others by more: bytes queue for no longer. */
static const int64_t LATE_MOST_NS = INT64_C(60000000000);

static int64_t add(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a + (uint64_t)b);
}

static int64_t subtract(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a - (uint64_t)b);
}

/* Rounded towards zero; not more than a word holds. */
static int64_t whole(double value)
{
    return value < 0x1p63 ? (int64_t)value : INT64_MAX;
}

/* What so many bytes take. */
static int64_t line_time(int64_t bytes, double byte_ns)
{
    return whole((double)bytes * byte_ns);
}

int canser_times_arrivals(const canser_piece *pieces, size_t piece_count, double byte_ns,
                          const int64_t *at, size_t count, int64_t *arrivals)
{
    if (!pieces || !piece_count || (count && (!at || !arrivals)))
        return CANSER_NULL;
    if (misaligned(pieces, _Alignof(canser_piece)) || misaligned(at, _Alignof(int64_t)) ||
        misaligned(arrivals, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (!(byte_ns >= 0))
        return CANSER_RANGE;

    /* The piece that the byte is in, and when the one before had come. */
    const canser_piece *const last = pieces + piece_count - 1;
    canser_piece piece = *pieces;
    int64_t before = INT64_MIN;

    for (size_t i = 0; i < count; i++) {
        while (piece.end <= at[i] && pieces < last) {
            before = piece.ns;
            piece = *++pieces;
        }
        const int64_t more = piece.end > at[i] ? subtract(piece.end, at[i]) - 1 : 0;
        const int64_t ns = subtract(piece.ns, line_time(more, byte_ns));
        arrivals[i] = ns > before ? ns : before;
    }
    return CANSER_OK;
}

/* The counter that a time of a decoder came from: time = ticks * tick_ns modulo 2^64, and the
 * counter is ticks modulo 2^32. A unit is an odd number shifted; an odd number has an inverse. */
typedef struct {
    uint64_t inverse; /* of the odd number, modulo 2^64 */
    unsigned shift;
} tick_unit;

static tick_unit unit_of(int64_t tick_ns)
{
    uint64_t odd = (uint64_t)tick_ns, inverse;
    unsigned shift = 0;

    for (; !(odd & 1); odd >>= 1)
        shift++;
    /* Right in the lowest 3 bits (an odd number times itself is 1 modulo 8); each step of Newton
     * doubles them. */
    inverse = odd;
    for (int bits = 3; bits < 64; bits *= 2)
        inverse *= 2 - odd * inverse;
    return (tick_unit){inverse, shift};
}

static uint32_t counter_of(int64_t time, tick_unit unit)
{
    return (uint32_t)(((uint64_t)time >> unit.shift) * unit.inverse);
}

/* Where the counter is expected at a time of the host; `per_tick` is 1 / tick_ns. A product and
 * not a quotient, which takes longer than all else here; what is lost is far less than a small
 * step. */
static uint64_t expect_ticks(const canser_reading *reading, int64_t host, double per_tick)
{
    return reading->ticks + (uint64_t)whole((double)subtract(host, reading->host) * per_tick);
}

/* The value nearest to `expected` at which a counter shows `raw`. */
static uint64_t nearest_turn(uint32_t raw, uint64_t expected)
{
    return expected + (uint64_t)(int64_t)(int32_t)(raw - (uint32_t)expected);
}

/* Whether a counter stands at most a small step of clock.h from where it is expected. */
static bool is_near(uint64_t ticks, uint64_t expected)
{
    return ticks - expected + SMALL_STEP <= 2 * (uint64_t)SMALL_STEP;
}

int canser_times_turns(canser_turns *self, int64_t tick_ns, const int64_t *arrivals, size_t count,
                       int64_t *times)
{
    if (!self || (count && (!arrivals || !times)))
        return CANSER_NULL;
    if (misaligned(arrivals, _Alignof(int64_t)) || misaligned(times, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (tick_ns < 1)
        return CANSER_TICK;

    const tick_unit unit = unit_of(tick_ns);
    const double per_tick = 1.0 / (double)tick_ns;
    canser_turns turns = *self;
    for (size_t i = 0; i < count; i++) {
        const uint32_t raw = counter_of(times[i], unit);
        canser_reading now = {raw, arrivals[i]};

        if (!turns.started) {
            turns.started = 1;
            turns.known = now;
            times[i] = (int64_t)(now.ticks * (uint64_t)tick_ns);
            continue;
        }
        const uint64_t expected = expect_ticks(&turns.known, now.host, per_tick);
        now.ticks = nearest_turn(raw, expected);
        if (is_near(now.ticks, expected)) {
            turns.known = now;
            turns.run = 0;
        } else {
            /* False, or the clock was set: then the next ones are near this one. */
            const uint64_t follows = expect_ticks(&turns.last, now.host, per_tick);
            const uint64_t ticks = nearest_turn(raw, follows);
            const bool goes_on = turns.run && is_near(ticks, follows);

            if (goes_on)
                now.ticks = ticks; /* half a turn away either turn is as near */
            turns.run = goes_on ? turns.run + 1 : 1;
            turns.last = now;
            if (turns.run == IN_LINE) {
                turns.known = now;
                turns.run = 0;
            }
        }
        times[i] = (int64_t)(now.ticks * (uint64_t)tick_ns);
    }
    *self = turns;
    return CANSER_OK;
}

/* How late a frame is, but for a constant. */
static int64_t delay_of(const canser_sample *frame)
{
    return subtract(frame->arrival, frame->device);
}

/* Put a frame among the lowest of its piece. */
static void add_lowest(canser_sampler *self, const canser_sample *frame)
{
    const int64_t delay = delay_of(frame);
    size_t at = self->count < CANSER_SAMPLER_MAX ? (size_t)self->count : CANSER_SAMPLER_MAX;

    for (; at && delay < delay_of(&self->lowest[at - 1]); at--)
        if (at < CANSER_SAMPLER_MAX)
            self->lowest[at] = self->lowest[at - 1];
    if (at < CANSER_SAMPLER_MAX)
        self->lowest[at] = *frame;
}

/* Take the next frames of a piece, one or more. Most are none of the lowest. */
static void add_frames(canser_sampler *self, const int64_t *device, const int64_t *arrivals,
                       size_t count)
{
    for (size_t i = 0; i < count; i++, self->count++)
        if (self->count < CANSER_SAMPLER_MAX ||
            subtract(arrivals[i], device[i]) < delay_of(&self->lowest[CANSER_SAMPLER_MAX - 1]))
            add_lowest(self, &(canser_sample){device[i], arrivals[i], 0, 0});
    self->last = arrivals[count - 1];
}

/* The sample of a piece of which all frames have come. */
static canser_sample take_sample(canser_sampler *self)
{
    const size_t count =
        self->count < CANSER_SAMPLER_MAX ? (size_t)self->count : CANSER_SAMPLER_MAX;
    const canser_sample *frame = self->lowest;

    while (frame + 1 < self->lowest + count &&
           subtract(delay_of(frame + 1), delay_of(frame)) > LATE_MOST_NS)
        frame++;
    self->count = 0;
    return (canser_sample){frame->device, frame->arrival, subtract(self->last, frame->arrival), 0};
}

int canser_times_sample(canser_sampler *self, const canser_piece *pieces, size_t piece_count,
                        const int64_t *at, size_t count, const int64_t *device,
                        const int64_t *arrivals, canser_sample *samples, size_t *sample_count)
{
    if (!sample_count)
        return CANSER_NULL;
    *sample_count = 0;
    if (!self || !pieces || !piece_count || (count && (!at || !device || !arrivals || !samples)))
        return CANSER_NULL;
    if (misaligned(pieces, _Alignof(canser_piece)) || misaligned(at, _Alignof(int64_t)) ||
        misaligned(device, _Alignof(int64_t)) || misaligned(arrivals, _Alignof(int64_t)) ||
        misaligned(samples, _Alignof(canser_sample)))
        return CANSER_MISALIGNED;

    const canser_piece *const last = pieces + piece_count - 1;
    for (size_t i = 0, end; i < count; i = end) {
        while (pieces->end <= at[i] && pieces < last)
            pieces++;
        if (self->count && pieces->end != self->piece_end) {
            samples[*sample_count] = take_sample(self);
            samples[(*sample_count)++].index = (int64_t)i;
        }
        self->piece_end = pieces->end;
        for (end = i + 1; end < count && (at[end] < pieces->end || pieces == last);)
            end++;
        add_frames(self, device + i, arrivals + i, end - i);
    }
    return CANSER_OK;
}

/* The host's time when the device's clock stood at `device`. */
static int64_t line_at(const canser_line *line, int64_t device)
{
    const int64_t run = subtract(device, line->device);
    return add(add(run, (int64_t)((double)run * line->drift)), line->host);
}

/* So that (int64_t) of any int64_t times it is defined. */
static bool is_drift(double drift)
{
    return drift > -1 && drift < 1;
}

int canser_times_heights(const canser_line *line, const int64_t *device, const int64_t *arrivals,
                         size_t count, int64_t *heights)
{
    if (!line || (count && (!device || !arrivals || !heights)))
        return CANSER_NULL;
    if (misaligned(device, _Alignof(int64_t)) || misaligned(arrivals, _Alignof(int64_t)) ||
        misaligned(heights, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (!is_drift(line->drift))
        return CANSER_RANGE;
    for (size_t i = 0; i < count; i++)
        heights[i] = subtract(arrivals[i], line_at(line, device[i]));
    return CANSER_OK;
}

int canser_times_map(const canser_line *line, const canser_trust *trust, const int64_t *device,
                     size_t count, int64_t *times, int64_t *latest)
{
    if (!line || !trust || !latest || (count && (!device || !times)))
        return CANSER_NULL;
    if (misaligned(device, _Alignof(int64_t)) || misaligned(times, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (!is_drift(line->drift) || trust->early < 0)
        return CANSER_RANGE;

    const int64_t least = -trust->early;
    int64_t held = *latest;
    for (size_t i = 0; i < count; i++) {
        const int64_t arrival = times[i], time = line_at(line, device[i]);
        const int64_t delay = subtract(arrival, time);
        const int64_t since = subtract(device[i], trust->reached);

        if (delay < least || delay > trust->late || since < least)
            continue;
        const int64_t possible = time < arrival ? time : arrival;
        held = possible > held ? possible : held;
        times[i] = held;
    }
    *latest = held;
    return CANSER_OK;
}

/* Bits of a value that are told apart in one go; so many counts, and so few values that are
 * put aside to be told apart by themselves. */
enum { DIGIT = 10, DIGITS = 1 << DIGIT };

/* The value of which `rank` others lie before it, among those of base to base + width. Each go
 * leaves a 1024th of that, so a few do, whatever the values are. */
static int64_t rank_between(const int64_t *values, size_t count, size_t rank, uint64_t base,
                            uint64_t width)
{
    int64_t few[DIGITS];

    while (width) {
        size_t counts[DIGITS] = {0}, digit = 0, few_count = 0;
        unsigned shift = 0;

        while (width >> shift >= DIGITS)
            shift++;
        for (size_t i = 0; i < count; i++) {
            const uint64_t above = (uint64_t)values[i] - base;

            if (above <= width)
                counts[above >> shift]++;
        }
        while (rank >= counts[digit])
            rank -= counts[digit++];
        base += (uint64_t)digit << shift;
        width = (UINT64_C(1) << shift) - 1;

        if (!width || counts[digit] > DIGITS || count <= DIGITS)
            continue;
        for (size_t i = 0; i < count; i++)
            if ((uint64_t)values[i] - base <= width)
                few[few_count++] = values[i];
        values = few;
        count = few_count;
    }
    return (int64_t)base;
}

int canser_times_rank(const int64_t *values, size_t count, size_t rank, canser_ranked *ranked)
{
    if (!ranked)
        return CANSER_NULL;
    *ranked = (canser_ranked){0};
    if (!values || rank >= count)
        return CANSER_NULL;
    if (misaligned(values, _Alignof(int64_t)))
        return CANSER_MISALIGNED;

    int64_t low = values[0], high = values[0];
    bool in_order = true;
    for (size_t i = 1; i < count; i++) {
        in_order &= values[i] >= values[i - 1];
        low = values[i] < low ? values[i] : low;
        high = values[i] > high ? values[i] : high;
    }
    ranked->low = low;
    ranked->high = high;
    /* Device times mostly are. */
    ranked->value =
        in_order ? values[rank]
                 : rank_between(values, count, rank, (uint64_t)low, (uint64_t)high - (uint64_t)low);
    return CANSER_OK;
}

int canser_times_lowest(const int64_t *values, size_t count, size_t rank, size_t *index)
{
    size_t lowest[CANSER_LOWEST_MAX], found = 0;

    if (!index)
        return CANSER_NULL;
    *index = 0;
    if (!values || rank >= count)
        return CANSER_NULL;
    if (misaligned(values, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (rank >= CANSER_LOWEST_MAX)
        return CANSER_RANGE;

    int64_t bound = INT64_MAX; /* what is not less is none of the lowest */
    for (size_t i = 0; i < count; i++) {
        if (found > rank && values[i] >= bound)
            continue;
        size_t at = found > rank ? rank : found++;
        for (; at && values[i] < values[lowest[at - 1]]; at--)
            lowest[at] = lowest[at - 1];
        lowest[at] = i;
        bound = values[lowest[found - 1]];
    }
    *index = lowest[rank];
    return CANSER_OK;
}
