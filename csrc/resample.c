/* Signals at other times than their own: the last value, or one on the line between two values.
 *
 * The grid and the samples are walked once, side by side. All that a point needs is in registers
 * from one sample to the next one. */
#include "protocol.h"

/* The distance of two times in nanoseconds, which may not fit into int64_t. */
CANSER_INLINE uint64_t distance(int64_t from, int64_t to)
{
    return (uint64_t)to - (uint64_t)from;
}

/* A time of the grid. `is_regular` is known where this is compiled. */
CANSER_INLINE int64_t grid_time(const canser_grid *grid, size_t index, bool is_regular)
{
    if (is_regular)
        return (int64_t)((uint64_t)grid->first + (uint64_t)index * (uint64_t)grid->step);
    return grid->times[index];
}

/* Values are 8 bytes of any type. */
CANSER_INLINE uint64_t load_value(const void *values, size_t index)
{
    uint64_t value;

    memcpy(&value, (const char *)values + 8 * index, sizeof value);
    return value;
}

CANSER_INLINE void store_value(void *out, size_t index, uint64_t value)
{
    memcpy((char *)out + 8 * index, &value, sizeof value);
}

/* Mark the points in front of the first sample as missing; return their number. */
CANSER_INLINE size_t skip_early(const canser_samples *samples, const canser_grid *grid,
                                uint64_t missing, void *out, uint8_t *valid, bool is_regular)
{
    size_t i = 0;

    while (i < grid->count &&
           (!samples->count || grid_time(grid, i, is_regular) < samples->ts[0])) {
        valid[i] = 0;
        store_value(out, i++, missing);
    }
    return i;
}

CANSER_INLINE void find_previous(const canser_samples *samples, const canser_grid *grid,
                                 uint64_t max_age, uint64_t missing, void *out, uint8_t *valid,
                                 bool is_regular)
{
    const int64_t *const ts = samples->ts;
    size_t passed = 0; /* samples at or before the point */
    int64_t next = INT64_MIN, last_valid = INT64_MIN;
    uint64_t value = missing;

    for (size_t i = skip_early(samples, grid, missing, out, valid, is_regular); i < grid->count;
         i++) {
        const int64_t t = grid_time(grid, i, is_regular);

        if (t >= next && passed < samples->count) {
            do
                passed++;
            while (passed < samples->count && ts[passed] <= t);
            value = load_value(samples->values, passed - 1);
            last_valid = max_age > distance(ts[passed - 1], INT64_MAX)
                             ? INT64_MAX
                             : (int64_t)((uint64_t)ts[passed - 1] + max_age);
            next = passed < samples->count ? ts[passed] : INT64_MAX;
        }
        valid[i] = t <= last_valid;
        store_value(out, i, t <= last_valid ? value : missing);
    }
}

/* The value on the line from `a` to `b`. It is never outside of them. */
CANSER_INLINE double between(double a, double b, double weight)
{
    const double least = a < b ? a : b, most = a < b ? b : a, rise = b - a;
    double value = a + rise * weight;

    if (rise - rise != 0) /* it is not finite: a value is not, or the rise is too large */
        value = a * (1 - weight) + b * weight;
    value = value < least ? least : value;
    return value > most ? most : value;
}

CANSER_INLINE double as_double(uint64_t word)
{
    double value;

    memcpy(&value, &word, sizeof value);
    return value;
}

CANSER_INLINE void interpolate(const canser_samples *samples, const canser_grid *grid,
                               uint64_t max_age, uint64_t missing, void *out, uint8_t *valid,
                               bool is_regular)
{
    const int64_t *const ts = samples->ts;
    size_t passed = 0;
    int64_t last = INT64_MIN, next = INT64_MIN, last_valid = INT64_MIN;
    double a = 0, b = 0, gap = 1;

    for (size_t i = skip_early(samples, grid, missing, out, valid, is_regular); i < grid->count;
         i++) {
        const int64_t t = grid_time(grid, i, is_regular);
        uint64_t word = missing;

        if (t >= next && passed < samples->count) {
            do
                passed++;
            while (passed < samples->count && ts[passed] <= t);
            last = last_valid = ts[passed - 1];
            a = as_double(load_value(samples->values, passed - 1));
            next = INT64_MAX;
            if (passed < samples->count) {
                next = ts[passed];
                b = as_double(load_value(samples->values, passed));
                gap = (double)distance(last, next);
                last_valid = distance(last, next) <= max_age ? next : last;
            }
        }
        if (t <= last_valid) {
            const double value = t == last ? a : between(a, b, (double)distance(last, t) / gap);
            memcpy(&word, &value, sizeof word);
        }
        valid[i] = t <= last_valid;
        store_value(out, i, word);
    }
}

/* Return what is wrong with the arguments. */
static int check(const canser_samples *samples, const canser_grid *grid, const void *out,
                 const uint8_t *valid)
{
    if (!samples || !grid || ((!samples->ts || !samples->values) && samples->count) ||
        ((!out || !valid) && grid->count))
        return CANSER_NULL;
    if (misaligned(samples->ts, _Alignof(int64_t)) || misaligned(grid->times, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    if (!grid->times && grid->count &&
        (grid->step < 1 ||
         grid->count - 1 > distance(grid->first, INT64_MAX) / (uint64_t)grid->step))
        return CANSER_RANGE;
    return CANSER_OK;
}

int canser_resample_previous(const canser_samples *samples, const canser_grid *grid,
                             uint64_t max_age, uint64_t missing, void *out, uint8_t *valid)
{
    const int status = check(samples, grid, out, valid);

    if (status)
        return status;
    if (grid->times)
        find_previous(samples, grid, max_age, missing, out, valid, false);
    else
        find_previous(samples, grid, max_age, missing, out, valid, true);
    return CANSER_OK;
}

int canser_resample_linear(const canser_samples *samples, const canser_grid *grid, uint64_t max_age,
                           uint64_t missing, void *out, uint8_t *valid)
{
    const int status = check(samples, grid, out, valid);

    if (status)
        return status;
    if (grid->times)
        interpolate(samples, grid, max_age, missing, out, valid, false);
    else
        interpolate(samples, grid, max_age, missing, out, valid, true);
    return CANSER_OK;
}

int canser_times_rise(const int64_t *ts, size_t count, uint8_t *rise)
{
    size_t falls = 0;

    if ((!ts && count) || !rise)
        return CANSER_NULL;
    if (misaligned(ts, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    for (size_t i = 1; i < count; i++)
        falls += ts[i] < ts[i - 1];
    *rise = falls == 0;
    return CANSER_OK;
}
