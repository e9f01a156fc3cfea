/* Host times of frames: when their bytes had come, and what a device's clock makes of it.
 *
 * What is done for each frame, and nothing else: what the clock stands at is estimated by
 * the caller. Differences of times are taken modulo 2^64, as device times out of noise
 * may be anything.
 */
#include "protocol.h"

static int64_t add(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a + (uint64_t)b);
}

static int64_t subtract(int64_t a, int64_t b)
{
    return (int64_t)((uint64_t)a - (uint64_t)b);
}

/* What so many bytes take, rounded down; not more than a word holds. */
static int64_t line_time(int64_t bytes, double byte_ns)
{
    const double ns = (double)bytes * byte_ns;
    return ns < 0x1p63 ? (int64_t)ns : INT64_MAX;
}

int canser_times_arrivals(const canser_piece *pieces, size_t piece_count, double byte_ns,
                          const int64_t *offsets, size_t count, int64_t end, int64_t reach,
                          int64_t *arrivals)
{
    if (!pieces || !piece_count || (count && (!offsets || !arrivals)))
        return CANSER_NULL;
    if (misaligned(pieces, _Alignof(canser_piece)) || misaligned(offsets, _Alignof(int64_t)) ||
        misaligned(arrivals, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (!(byte_ns >= 0))
        return CANSER_RANGE;

    /* The piece that the byte is in, and when the one before had come. */
    const canser_piece *const last = pieces + piece_count - 1;
    canser_piece piece = *pieces;
    int64_t before = INT64_MIN;

    for (size_t i = 0; i < count; i++) {
        const int64_t next = i + 1 < count ? offsets[i + 1] : end;
        const int64_t reached = add(offsets[i], reach);
        const int64_t behind = reached < next ? reached : next;

        while (piece.end < behind && pieces < last) {
            before = piece.ns;
            piece = *++pieces;
        }
        const int64_t more = piece.end > behind ? subtract(piece.end, behind) : 0;
        const int64_t ns = subtract(piece.ns, line_time(more, byte_ns));
        arrivals[i] = ns > before ? ns : before;
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
