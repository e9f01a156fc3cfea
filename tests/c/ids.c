/* Frames by their ids: the same rows and steps however the frames are cut and however
 * small the arrays are, no byte touched past an array, and the errors of each call.
 *
 *     ids [rounds]
 */
#include "guarded.h"

#include "canser.h"
#include "checks.h"

#include <string.h>

enum { FRAMES = 600, LISTS = 200 };

/* All that a walk fills. The arrays end at a page that may not be touched. */
typedef struct {
    canser_ids ids;
    uint32_t *row_of;
    int64_t *steps;
    uint64_t *lists[LISTS];
} walk;

static canser_frame *frames;
static uint8_t *channels;

static void make_frames(size_t count)
{
    int64_t ts = (int64_t)random_below(1000000000);

    for (size_t i = 0; i < count; i++) {
        canser_frame *const frame = &frames[i];
        const size_t kind = random_below(40);

        memset(frame, 0, sizeof *frame);
        frame->id = (uint32_t)random_below(random_below(9) ? 4 : 0x20000000);
        frame->ext = random_below(3) == 0;
        frame->rtr = random_below(9) == 0;
        frame->err = random_below(9) == 0;
        frame->dlc = (uint8_t)random_below(9);
        frame->data[0] = (uint8_t)random_below(2);
        ts += (int64_t)random_below(5000000);
        ts += kind == 0 ? 5000000000 : kind == 1 ? -3000000000 : 0;
        frame->ts = kind == 2   ? CANSER_NO_TIME
                    : kind == 3 ? (int64_t)random_word()
                    : kind == 4 ? INT64_MIN + (int64_t)random_below(9)
                    : kind == 5 ? INT64_MAX - (int64_t)random_below(9)
                                : ts;
        channels[i] = (uint8_t)(random_below(3) ? 255 : random_below(2));
    }
}

static void begin(walk *self, bool is_remote_apart, bool keeps_steps, size_t row_most)
{
    memset(&self->ids, 0, sizeof self->ids);
    self->ids.is_remote_apart = is_remote_apart;
    self->ids.row_most = row_most;
    self->ids.spread = random_below(2) ? 0 : random_word() | 1;
    if (keeps_steps)
        self->ids.lists = self->lists;
}

/* Give the walk more room, in arrays of their own. */
static void grow(walk *self)
{
    canser_ids *const ids = &self->ids;

    if (ids->row_count == ids->row_cap) {
        const size_t cap = ids->row_cap ? 2 * ids->row_cap : 1;
        canser_id *const rows = calloc(cap, sizeof *rows);

        if (ids->row_count)
            memcpy(rows, ids->rows, ids->row_count * sizeof *rows);
        free(ids->rows);
        free(ids->slots);
        ids->rows = rows;
        ids->row_cap = cap;
        ids->slot_cap = 2 * cap;
        ids->slots = calloc(ids->slot_cap, sizeof *ids->slots);
        check(canser_ids_fill_slots(ids) == CANSER_OK, "fill");
    }
    if (ids->lists && ids->list_count + 1 >= ids->list_cap) {
        ids->lists[ids->list_cap] = calloc(CANSER_STEP_LIST, sizeof **ids->lists);
        ids->list_cap++;
    }
}

static void end(walk *self)
{
    free(self->ids.rows);
    free(self->ids.slots);
    for (size_t i = 0; i < self->ids.list_cap; i++)
        free(self->lists[i]);
}

static void add(walk *self, size_t count, bool is_cut, bool is_told)
{
    size_t done = 0;

    while (done < count) {
        const size_t left = count - done;
        const size_t part = is_cut ? 1 + random_below(left) : left;
        size_t used;

        grow(self);
        check(canser_ids_add(&self->ids, frames + done, part, is_told ? channels + done : NULL,
                             self->row_of + done, self->steps + done, &used) == CANSER_OK,
              "add");
        done += used;
    }
}

static bool are_equal(const walk *a, const walk *b, size_t count)
{
    if (a->ids.row_count != b->ids.row_count || a->ids.others != b->ids.others ||
        memcmp(&a->ids.runs, &b->ids.runs, sizeof a->ids.runs) ||
        memcmp(a->row_of, b->row_of, count * sizeof *a->row_of) ||
        memcmp(a->steps, b->steps, count * sizeof *a->steps))
        return false;
    return !a->ids.row_count ||
           !memcmp(a->ids.rows, b->ids.rows, a->ids.row_count * sizeof *a->ids.rows);
}

/* The sums of the rows are those of the frames. */
static void check_sums(const walk *self, size_t count)
{
    uint64_t counted = self->ids.others, steps = 0;

    for (size_t i = 0; i < self->ids.row_count; i++) {
        const canser_id *const row = &self->ids.rows[i];
        counted += row->steps + row->breaks;
        steps += row->steps;
    }
    check(counted == count, "each frame is counted once");
    for (size_t i = 0; i < count; i++)
        steps -= self->steps[i] != CANSER_NO_STEP;
    check(steps == 0, "each step is counted once");
}

static void check_orders(const walk *self, size_t count)
{
    const size_t row_count = self->ids.row_count;
    int64_t *const next = malloc((row_count + 1) * sizeof *next);
    int64_t *const ends = malloc((row_count + 1) * sizeof *ends);
    int64_t *const out = malloc((count + 1) * sizeof *out);
    int64_t sum = 0;
    bool is_stable = true;

    for (size_t r = 0; r < row_count; r++) {
        next[r] = sum;
        sum += (int64_t)(self->ids.rows[r].steps + self->ids.rows[r].breaks);
        ends[r] = sum;
    }
    check(canser_order_rows(self->row_of, NULL, count, next, ends, row_count, out, (size_t)sum) ==
              CANSER_OK,
          "order");
    for (int64_t i = 1; i < sum; i++)
        is_stable &= self->row_of[out[i - 1]] < self->row_of[out[i]] ||
                     (self->row_of[out[i - 1]] == self->row_of[out[i]] && out[i - 1] < out[i]);
    check(is_stable, "rows in order, and frames within");
    if (sum)
        check(canser_order_rows(self->row_of, NULL, count, next, ends, row_count, out,
                                (size_t)sum) == CANSER_RANGE,
              "no room is left");
    if (row_count) {
        next[0] = -1;
        check(canser_order_rows(self->row_of, NULL, count, next, ends, row_count, out,
                                (size_t)sum) == CANSER_RANGE,
              "a place in front of all");
    }
    free(next);
    free(ends);
    free(out);
}

static void check_errors(void)
{
    canser_id row;
    uint32_t slots[2] = {0, 0}, row_of[2];
    size_t used = 9;
    canser_ids ids = {.rows = &row, .row_cap = 1, .row_most = 1, .slots = slots, .slot_cap = 2};
    const canser_frame *const odd = (const canser_frame *)(const void *)((const char *)frames + 1);

    check(canser_ids_add(NULL, frames, 1, NULL, NULL, NULL, &used) == CANSER_NULL && !used, "null");
    check(canser_ids_add(&ids, NULL, 1, NULL, NULL, NULL, &used) == CANSER_NULL, "no frames");
    check(canser_ids_add(&ids, NULL, 0, NULL, NULL, NULL, &used) == CANSER_OK, "none");
    check(canser_ids_add(&ids, odd, 1, NULL, NULL, NULL, &used) == CANSER_MISALIGNED, "odd");
    ids.slot_cap = 1;
    check(canser_ids_add(&ids, frames, 1, NULL, NULL, NULL, &used) == CANSER_RANGE, "few slots");
    ids.slot_cap = 3;
    check(canser_ids_fill_slots(&ids) == CANSER_RANGE, "no power of two");
    ids.slot_cap = 2;
    check(canser_ids_group(&ids, frames, 1, NULL, NULL, &used) == CANSER_NULL, "no rows");
    check(canser_ids_group(&ids, odd, 1, NULL, row_of, &used) == CANSER_MISALIGNED, "odd");
    check(canser_runs_add(NULL, frames, 1, row_of) == CANSER_NULL, "no runs");
    check(canser_runs_add(&ids.runs, odd, 1, row_of) == CANSER_MISALIGNED, "odd");
    check(canser_order_rows(NULL, NULL, 1, NULL, NULL, 0, NULL, 0) == CANSER_NULL, "no order");
}

static void run_round(size_t round)
{
    walk whole, parts;
    const size_t count = 1 + random_below(FRAMES);
    const bool is_remote_apart = random_below(2), keeps_steps = random_below(2);
    const bool is_told = random_below(2);
    const size_t row_most = random_below(3) ? SIZE_MAX : 1 + random_below(9);

    whole.row_of = malloc(count * sizeof *whole.row_of);
    whole.steps = malloc(count * sizeof *whole.steps);
    parts.row_of = malloc(count * sizeof *parts.row_of);
    parts.steps = malloc(count * sizeof *parts.steps);
    frames = (canser_frame *)(void *)(guarded(FRAMES * sizeof *frames) - count * sizeof *frames);
    channels = guarded(FRAMES) - count;
    make_frames(count);
    begin(&whole, is_remote_apart, keeps_steps, row_most);
    begin(&parts, is_remote_apart, keeps_steps, row_most);
    add(&whole, count, false, is_told);
    add(&parts, count, true, is_told);
    check(are_equal(&whole, &parts, count), "cut anywhere");
    check_sums(&whole, count);
    check_orders(&whole, count);
    if (!round)
        check_errors();
    end(&whole);
    end(&parts);
    free(whole.row_of);
    free(whole.steps);
    free(parts.row_of);
    free(parts.steps);
}

int main(int argc, char **argv)
{
    const unsigned long rounds = argc > 1 ? strtoul(argv[1], NULL, 10) : 200;

    for (unsigned long i = 0; i < rounds; i++)
        run_round(i);
    return told();
}
