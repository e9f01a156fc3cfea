/* Signals at other times than their own: as by a search through all samples, for grids by steps and
 * by times, up to the first and the last time; no byte touched past an array, and the errors of
 * each call.
 *
 *     resample [rounds]
 */
#include "guarded.h"

#include "canser.h"
#include "checks.h"

#include <string.h>

enum { SAMPLES = 40, POINTS = 60 };

static const uint64_t missing = UINT64_C(0x7FF8123456789ABC);

/* Arrays that end at a page that may not be touched. */
static int64_t *ts_end, *times_end;
static uint8_t *values_end, *out_end, *valid_end;

static int compare(const void *a, const void *b)
{
    int64_t first, second;

    memcpy(&first, a, sizeof first);
    memcpy(&second, b, sizeof second);
    return first < second ? -1 : first > second;
}

static int64_t random_time(size_t kind)
{
    if (kind == 0 || random_below(8) == 0)
        return (int64_t)random_word();
    if (random_below(8) == 0)
        return random_below(2) ? INT64_MAX - (int64_t)random_below(3)
                               : INT64_MIN + (int64_t)random_below(3);
    return (int64_t)random_below(kind == 1 ? 20 : 1000) - 10;
}

static void make_times(int64_t *times, size_t count, size_t kind)
{
    for (size_t i = 0; i < count; i++)
        times[i] = random_time(kind);
    qsort(times, count, sizeof *times, compare);
}

static uint64_t distance(int64_t from, int64_t to)
{
    return (uint64_t)to - (uint64_t)from;
}

static double value_at(const uint8_t *values, size_t index)
{
    double value;

    memcpy(&value, values + 8 * index, sizeof value);
    return value;
}

static bool is_previous(const canser_samples *samples, uint64_t max_age, int64_t t,
                        const uint8_t *out, uint8_t valid)
{
    size_t before = samples->count;

    for (size_t i = 0; i < samples->count; i++)
        if (samples->ts[i] <= t)
            before = i;
    if (before == samples->count || distance(samples->ts[before], t) > max_age)
        return valid == 0 && !memcmp(out, &missing, 8);
    return valid == 1 && !memcmp(out, (const uint8_t *)samples->values + 8 * before, 8);
}

static bool is_on_line(const canser_samples *samples, uint64_t max_age, int64_t t,
                       const uint8_t *out, uint8_t valid)
{
    const uint8_t *const values = samples->values;
    size_t before = samples->count, behind = samples->count;
    double a, b, found, expected, error, weight;

    for (size_t i = 0; i < samples->count; i++) {
        if (samples->ts[i] <= t)
            before = i;
        else if (behind == samples->count)
            behind = i;
    }
    if (before < samples->count && samples->ts[before] == t)
        return valid == 1 && !memcmp(out, values + 8 * before, 8);
    if (before == samples->count || behind == samples->count ||
        distance(samples->ts[before], samples->ts[behind]) > max_age)
        return valid == 0 && !memcmp(out, &missing, 8);
    a = value_at(values, before);
    b = value_at(values, behind);
    weight = (double)distance(samples->ts[before], t) /
             (double)distance(samples->ts[before], samples->ts[behind]);
    expected = a * (1 - weight) + b * weight;
    error = 1e-14 * ((a < 0 ? -a : a) / 2 + (b < 0 ? -b : b) / 2) + 5e-324;
    memcpy(&found, out, sizeof found);
    return valid == 1 && found >= (a < b ? a : b) && found <= (a < b ? b : a) &&
           found / 2 - expected / 2 <= error && expected / 2 - found / 2 <= error;
}

static void run_round(void)
{
    static const double kinds[] = {-3, 0.1, -0.3, -0.0, 5e-324, 1e300, -1.7e308, 1.7e308};
    const size_t sample_count = random_below(SAMPLES + 1), point_count = random_below(POINTS + 1);
    const size_t kind = random_below(3);
    const uint64_t max_age = random_below(3)   ? random_below(60)
                             : random_below(2) ? UINT64_MAX
                                               : random_word();
    int64_t *const ts = ts_end - sample_count, *const times = times_end - point_count;
    const size_t shift = random_below(2) ? 3 : 0; /* values need not be aligned */
    uint8_t *const values = values_end - shift - 8 * sample_count;
    uint8_t *const out = out_end - shift - 8 * point_count;
    uint8_t *const valid = valid_end - point_count;
    const canser_samples samples = {ts, values, sample_count};
    canser_grid grid = {times, 0, 0, point_count};
    bool are_previous = true, are_on_lines = true;

    make_times(ts, sample_count, kind);
    make_times(times, point_count, kind);
    for (size_t i = 0; i < sample_count; i++) {
        memcpy(values + 8 * i, &kinds[random_below(sizeof kinds / sizeof *kinds)], 8);
    }
    if (random_below(2)) {
        grid.times = NULL;
        grid.first = random_time(kind);
        grid.step = 1 + (int64_t)random_below(random_below(2) ? 30 : INT64_MAX);
        while (grid.count &&
               distance(grid.first, INT64_MAX) / (uint64_t)grid.step < grid.count - 1) {
            check(canser_resample_linear(&samples, &grid, max_age, missing, out, valid) ==
                      CANSER_RANGE,
                  "a grid behind the last time");
            grid.count--;
        }
        for (size_t i = 0; i < grid.count; i++)
            times[i] = (int64_t)((uint64_t)grid.first + i * (uint64_t)grid.step);
    }
    check(canser_resample_previous(&samples, &grid, max_age, missing, out, valid) == CANSER_OK,
          "previous");
    for (size_t i = 0; i < grid.count; i++)
        are_previous &= is_previous(&samples, max_age, times[i], out + 8 * i, valid[i]);
    check(are_previous, "the last values");
    check(canser_resample_linear(&samples, &grid, max_age, missing, out, valid) == CANSER_OK,
          "linear");
    for (size_t i = 0; i < grid.count; i++)
        are_on_lines &= is_on_line(&samples, max_age, times[i], out + 8 * i, valid[i]);
    check(are_on_lines, "values on lines");
}

/* Times that do not rise lead to no access out of the arrays. */
static void run_wild(void)
{
    const size_t sample_count = random_below(SAMPLES + 1), point_count = random_below(POINTS + 1);
    int64_t *const ts = ts_end - sample_count, *const times = times_end - point_count;
    const canser_samples samples = {ts, values_end - 8 * sample_count, sample_count};
    const canser_grid grid = {times, 0, 0, point_count};
    uint8_t *const out = out_end - 8 * point_count, *const valid = valid_end - point_count;
    bool rises = true;
    uint8_t found;

    for (size_t i = 0; i < sample_count; i++)
        ts[i] = random_time(random_below(3));
    for (size_t i = 0; i < point_count; i++)
        times[i] = random_time(random_below(3));
    check(canser_resample_previous(&samples, &grid, 5, missing, out, valid) == CANSER_OK, "wild");
    check(canser_resample_linear(&samples, &grid, 5, missing, out, valid) == CANSER_OK, "wild");
    if (random_below(2))
        qsort(ts, sample_count, sizeof *ts, compare);
    for (size_t i = 1; i < sample_count; i++)
        rises &= ts[i] >= ts[i - 1];
    check(canser_times_rise(ts, sample_count, &found) == CANSER_OK && found == rises, "rise");
}

static void check_errors(void)
{
    int64_t times[2] = {1, 2};
    uint64_t values[2] = {3, 4}, out[2] = {5, 6};
    uint8_t valid[2], rise;
    const int64_t *const odd = (const int64_t *)(const void *)((const char *)times + 1);
    canser_samples samples = {times, values, 2};
    canser_grid grid = {times, 0, 0, 2};

    check(canser_resample_previous(NULL, &grid, 0, 0, out, valid) == CANSER_NULL, "no samples");
    check(canser_resample_previous(&samples, NULL, 0, 0, out, valid) == CANSER_NULL, "no grid");
    check(canser_resample_previous(&samples, &grid, 0, 0, NULL, valid) == CANSER_NULL, "no out");
    check(canser_resample_linear(&samples, &grid, 0, 0, out, NULL) == CANSER_NULL, "no valid");
    samples.ts = NULL;
    check(canser_resample_linear(&samples, &grid, 0, 0, out, valid) == CANSER_NULL, "no times");
    samples.ts = times;
    samples.values = NULL;
    check(canser_resample_linear(&samples, &grid, 0, 0, out, valid) == CANSER_NULL, "no values");
    samples.count = 0;
    samples.ts = NULL;
    grid.count = 0;
    check(canser_resample_linear(&samples, &grid, 0, 0, NULL, NULL) == CANSER_OK, "nothing");
    samples.ts = odd;
    check(canser_resample_linear(&samples, &grid, 0, 0, out, valid) == CANSER_MISALIGNED, "odd");
    samples.ts = times;
    grid.times = odd;
    check(canser_resample_previous(&samples, &grid, 0, 0, out, valid) == CANSER_MISALIGNED, "odd");
    grid.times = NULL;
    grid.count = 1;
    check(canser_resample_previous(&samples, &grid, 0, 0, out, valid) == CANSER_RANGE, "no step");
    grid.step = -1;
    check(canser_resample_linear(&samples, &grid, 0, 0, out, valid) == CANSER_RANGE, "a step back");
    check(out[0] == 5 && out[1] == 6, "nothing was written");
    check(canser_times_rise(NULL, 0, &rise) == CANSER_OK && rise == 1, "no times");
    check(canser_times_rise(NULL, 1, &rise) == CANSER_NULL, "null");
    check(canser_times_rise(times, 1, NULL) == CANSER_NULL, "null");
    check(canser_times_rise(odd, 1, &rise) == CANSER_MISALIGNED, "odd");
}

int main(int argc, char **argv)
{
    const unsigned long rounds = argc > 1 ? strtoul(argv[1], NULL, 10) : 2000;

    ts_end = (int64_t *)(void *)guarded(SAMPLES * sizeof *ts_end);
    times_end = (int64_t *)(void *)guarded(POINTS * sizeof *times_end);
    values_end = guarded(8 * SAMPLES + 3);
    out_end = guarded(8 * POINTS + 3);
    valid_end = guarded(POINTS);
    for (unsigned long i = 0; i < rounds; i++) {
        run_round();
        run_wild();
    }
    check_errors();
    return told();
}
