/* Times of frames, from the arrivals of their bytes and from a device's clock.
 *
 * This is the work for each frame, in one pass. The caller estimates the device's clock.
 * Differences of times are taken modulo 2^64, as device times out of noise may have any value.
 */
#include "clock.h"

/* The most by which a true frame of a piece is less late than the others: bytes queue for a minute
 * at most. */
static const int64_t LATE_MOST_NS = INT64_C(60000000000);

CANSER_INLINE int64_t add(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a + (uint64_t)b);
}

CANSER_INLINE int64_t subtract(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a - (uint64_t)b);
}

/* The coarsest unit for which a decoder's time differs from the true one by a shift only: up to
 * milliseconds no clock turns so often that the 64 bits of the time wrap. */
static const int64_t SHIFT_TICK_MAX = 1000000;

/* Bytes that came together, and the values that date them. */
typedef struct {
    int64_t last;   /* offset of the last byte */
    int64_t ns;     /* arrival of that byte */
    int64_t before; /* arrival of the piece before */
    double byte_ns; /* time of a byte on the line */
} dated_piece;

/* Return the arrival of the byte at offset `at`. */
CANSER_INLINE int64_t arrival_of(const dated_piece *piece, int64_t at)
{
    /* 32 bits, so that the product fits an int64_t even for invalid offsets. */
    const uint32_t behind = (uint32_t)subtract(piece->last, at);
    const int64_t arrival = subtract(piece->ns, (int64_t)((double)behind * piece->byte_ns));
    return arrival > piece->before ? arrival : piece->before;
}

/* Return the first frame, at ascending offsets, that lies behind a piece. */
CANSER_INLINE size_t find_border(const int64_t *at, size_t first, size_t count, int64_t last)
{
    /* Mostly all frames are in the piece, or only a few. */
    if (at[count - 1] <= last)
        return count;
    while (at[first] <= last)
        first++;
    return first;
}

/* Return the host's time by the line for a time of the device. */
CANSER_INLINE int64_t line_at(const canser_line *line, int64_t device)
{
    const int64_t run = subtract(device, line->device);
    return add(add(run, (int64_t)((double)run * line->drift)), line->host);
}

/* Return the counter of which a decoder made a time, in nanoseconds: time = ticks * tick_ns modulo
 * 2^64, and the counter is ticks modulo 2^32. */
static int64_t counter_time(int64_t time, int64_t tick_ns)
{
    /* A unit is an odd number shifted; an odd number has an inverse modulo 2^64. */
    uint64_t odd = (uint64_t)tick_ns, ticks = (uint64_t)time;

    for (; !(odd & 1); odd >>= 1)
        ticks >>= 1;
    /* Right in the lowest 3 bits (an odd number times itself is 1 modulo 8); each step of Newton
     * doubles them. */
    uint64_t inverse = odd;
    for (int bits = 3; bits < 32; bits *= 2)
        inverse *= 2 - odd * inverse;
    return (int64_t)((ticks * inverse & UINT32_MAX) * (uint64_t)tick_ns);
}

/* Return the time nearest to `expected` at which the counter has the value that it has at `time`.
 */
static int64_t nearest_turn(int64_t time, int64_t expected, int64_t tick_ns)
{
    const int64_t turn_ns = tick_ns << 32, apart = subtract(expected, time);
    const int64_t rest = apart % turn_ns;
    int64_t turns = apart / turn_ns;

    if (rest > turn_ns / 2)
        turns++;
    else if (rest <= -turn_ns / 2)
        turns--;
    return (int64_t)((uint64_t)time + (uint64_t)turns * (uint64_t)turn_ns);
}

/* The most by which a device time may differ from the one expected from those before it. */
CANSER_INLINE int64_t near_ns(int64_t tick_ns)
{
    return SMALL_STEP * tick_ns;
}

static bool is_near(int64_t delay, int64_t other, int64_t most)
{
    return (uint64_t)add(subtract(delay, other), most) <= 2 * (uint64_t)most;
}

/* Return the device's time of a frame that is not near those before it: a time of another turn of
 * the counter, a false time, or a time of a clock that was set. */
CANSER_COLD int64_t find_turn(canser_turns *turns, int64_t tick_ns, int64_t time, int64_t arrival)
{
    const int64_t counter = counter_time(time, tick_ns), most = near_ns(tick_ns);
    int64_t device = nearest_turn(counter, subtract(arrival, turns->delay), tick_ns);

    if (is_near(subtract(arrival, device), turns->delay, most)) {
        turns->run = 0;
    } else {
        /* False, or the clock was set: then the next ones are near this one. */
        const int64_t next = nearest_turn(counter, subtract(arrival, turns->last_delay), tick_ns);
        const bool goes_on =
            turns->run && is_near(subtract(arrival, next), turns->last_delay, most);

        if (goes_on)
            device = next; /* at half a turn, both turns are equally near */
        turns->run = goes_on ? turns->run + 1 : 1;
        turns->last_delay = subtract(arrival, device);
        if (turns->run < IN_LINE)
            return device;
        turns->run = 0;
    }
    turns->delay = subtract(arrival, device);
    turns->shift = subtract(device, time);
    return device;
}

/* Start with the first frame: it keeps the value of its counter. */
static void start_turns(canser_turns *turns, int64_t tick_ns, int64_t time, int64_t arrival)
{
    const int64_t device = counter_time(time, tick_ns);

    turns->started = 1;
    turns->delay = subtract(arrival, device);
    turns->shift = subtract(device, time);
}

static int64_t delay_of(const canser_sample *frame)
{
    return subtract(frame->arrival, frame->device);
}

/* Insert a frame into the least late ones of its piece; return the delay above which a frame is
 * none of them. */
CANSER_NOINLINE int64_t add_least_late(canser_least_late *self, int64_t device, int64_t arrival)
{
    const int64_t delay = subtract(arrival, device);
    size_t at = self->count < CANSER_LEAST_LATE ? self->count++ : CANSER_LEAST_LATE - 1;

    for (; at && delay < delay_of(&self->frames[at - 1]); at--)
        self->frames[at] = self->frames[at - 1];
    self->frames[at] = (canser_sample){device, arrival, 0};
    return self->count < CANSER_LEAST_LATE ? INT64_MAX
                                           : delay_of(&self->frames[CANSER_LEAST_LATE - 1]);
}

/* Return the sample of a piece of which all frames have come. */
static canser_sample take_sample(canser_least_late *self, int64_t last)
{
    const canser_sample *frame = self->frames;

    while (frame + 1 < self->frames + self->count &&
           subtract(delay_of(frame + 1), delay_of(frame)) > LATE_MOST_NS)
        frame++;
    self->count = 0;
    return (canser_sample){frame->device, frame->arrival, subtract(last, frame->arrival)};
}

/* The time that a frame gets. */
typedef enum { DEVICE_TIME, ARRIVAL_TIME, LINE_TIME } time_kind;

/* Go on to the piece that holds the byte at `at`, or the last one if none does. Return it, and set
 * the values that date it. `less` is 1, or 0 if offsets are those behind the bytes. */
CANSER_INLINE const canser_piece *find_piece(const canser_piece *pieces, const canser_piece *end,
                                             int64_t at, int64_t less, dated_piece *piece)
{
    while (subtract(pieces->end, less) < at && pieces + 1 < end)
        piece->before = (pieces++)->ns;
    piece->ns = pieces->ns;
    piece->last = subtract(pieces->end, less);
    if (piece->last < at) { /* the last piece also dates all bytes behind it */
        piece->last = INT64_MAX;
        piece->byte_ns = 0;
    }
    return pieces;
}

/* Set the times of frames in a piece. */
CANSER_INLINE void assign_piece(canser_timing *self, const dated_piece *piece, const int64_t *at,
                                canser_frame *frames, size_t first, size_t border,
                                const time_kind kind)
{
    const int64_t most = near_ns(self->tick_ns), early = self->trust.early;
    /* In a coarse unit, a time that is a few turns off has wrapped: it may be near, but lies
     * between two ticks. */
    const uint64_t near_span = self->tick_ns > SHIFT_TICK_MAX ? 0 : 2 * (uint64_t)most;
    const uint64_t late_span = (uint64_t)(self->trust.late + early);
    /* Device times and delays below these are not believed. */
    const int64_t device_least = subtract(self->trust.reached, early);
    int64_t delay_least = subtract(self->turns.delay, most);
    const canser_line line = self->line;
    int64_t shift = self->turns.shift, latest = self->latest, arrival = self->arrived;
    int64_t bound = self->least_late.count < CANSER_LEAST_LATE
                        ? INT64_MAX
                        : delay_of(&self->least_late.frames[CANSER_LEAST_LATE - 1]);

    for (size_t i = first; i < border; i++) {
        arrival = arrival_of(piece, at[i]);
        int64_t device = add(frames[i].ts, shift);
        int64_t delay = subtract(arrival, device);

        if (CANSER_LIKELY((uint64_t)subtract(delay, delay_least) <= near_span)) {
            delay_least = subtract(delay, most);
            self->turns.run = 0;
        } else {
            self->turns.delay = add(delay_least, most);
            device = find_turn(&self->turns, self->tick_ns, frames[i].ts, arrival);
            shift = self->turns.shift;
            delay_least = subtract(self->turns.delay, most);
            delay = subtract(arrival, device);
        }
        if (kind == DEVICE_TIME) {
            frames[i].ts = device;
            continue;
        }
        if (delay < bound)
            bound = add_least_late(&self->least_late, device, arrival);
        int64_t time = arrival;
        if (kind == LINE_TIME) {
            const int64_t host = line_at(&line, device);

            if ((uint64_t)add(subtract(arrival, host), early) <= late_span &&
                subtract(device, device_least) >= 0) {
                time = host < arrival ? host : arrival;
                time = latest = time > latest ? time : latest;
            }
        }
        frames[i].ts = time;
    }
    self->turns.delay = add(delay_least, most);
    self->arrived = arrival;
    self->latest = kind == LINE_TIME ? latest : arrival;
}

/* Set the times of frames without times of a device. */
static void assign_arrivals(const canser_timing *self, const canser_piece *pieces,
                            const canser_piece *end, const int64_t *ends, canser_frame *frames,
                            size_t count, size_t *done)
{
    dated_piece piece = {0, 0, INT64_MIN, self->byte_ns};

    for (size_t i = *done; i < count;) {
        pieces = find_piece(pieces, end, ends[i], 0, &piece);
        const size_t border = find_border(ends, i, count, piece.last);
        for (; i < border; i++)
            frames[i].ts = arrival_of(&piece, ends[i]);
    }
    *done = count;
}

/* Take the sample of the piece before; return why the call must stop, 0 if it goes on. */
static int add_sample(canser_timing *self)
{
    if (self->sample_count == self->sample_cap)
        return CANSER_TIMING_FULL;
    self->samples[self->sample_count++] = take_sample(&self->least_late, self->arrived);
    const canser_sample *const first = self->samples;
    const canser_sample *const last = first + self->sample_count - 1;
    const bool is_long = subtract(last->arrival, first->arrival) >= self->bucket_ns;
    return (is_long && self->sample_count >= self->bucket_least) ||
                   self->sample_count >= self->bucket_most
               ? CANSER_TIMING_BUCKET
               : CANSER_TIMING_DONE;
}

/* Set the times of frames with times of a device. */
static void assign_device(canser_timing *self, const canser_piece *pieces, const canser_piece *end,
                          const int64_t *begins, canser_frame *frames, size_t count, size_t *done)
{
    dated_piece piece = {0, 0, INT64_MIN, self->byte_ns};

    for (size_t i = *done; i < count; *done = i) {
        pieces = find_piece(pieces, end, begins[i], 1, &piece);
        const int64_t arrival = arrival_of(&piece, begins[i]);
        if (!self->turns.started) {
            start_turns(&self->turns, self->tick_ns, frames[i].ts, arrival);
        } else if (!self->keeps_device && pieces->end != self->piece_end) {
            if (subtract(arrival, self->arrived) > self->silence_ns) {
                self->arrived = arrival;
                self->stopped = CANSER_TIMING_SILENCE;
                return;
            }
            if (self->least_late.count && (self->stopped = add_sample(self)))
                return;
        }
        self->piece_end = pieces->end;
        const size_t border = find_border(begins, i, count, piece.last);
        if (self->keeps_device)
            assign_piece(self, &piece, begins, frames, i, border, DEVICE_TIME);
        else if (self->has_line)
            assign_piece(self, &piece, begins, frames, i, border, LINE_TIME);
        else
            assign_piece(self, &piece, begins, frames, i, border, ARRIVAL_TIME);
        i = border;
    }
}

int canser_timing_assign(canser_timing *self, const canser_piece *pieces, size_t piece_count,
                         const int64_t *at, canser_frame *frames, size_t count, size_t *done)
{
    if (!self || !done || !pieces || !piece_count || (*done < count && (!at || !frames)) ||
        (self->sample_cap && !self->samples))
        return CANSER_NULL;
    if (misaligned(pieces, _Alignof(canser_piece)) || misaligned(at, _Alignof(int64_t)) ||
        misaligned(frames, _Alignof(canser_frame)) ||
        misaligned(self->samples, _Alignof(canser_sample)))
        return CANSER_MISALIGNED;
    if (self->tick_ns < 0 || self->tick_ns > INT32_MAX)
        return CANSER_TICK;
    /* With this drift, the product with any int64_t fits an int64_t. */
    if (!(self->byte_ns >= 0 && self->byte_ns <= CANSER_BYTE_NS_MAX) ||
        !(self->line.drift > -1 && self->line.drift < 1) || self->trust.early < 0 ||
        self->trust.late < 0)
        return CANSER_RANGE;

    self->stopped = CANSER_TIMING_DONE;
    if (self->tick_ns)
        assign_device(self, pieces, pieces + piece_count, at, frames, count, done);
    else
        assign_arrivals(self, pieces, pieces + piece_count, at, frames, count, done);
    return CANSER_OK;
}
