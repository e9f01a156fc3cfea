/* Frames by their ids: statistics in one pass, and stable orders.
 *
 * A row is found by its key in an open hash. The key is the first 8 bytes of a frame, with the
 * channel in the place of the dlc. */
#include "keys.h"
#include "runs.h"

/* Without another number rows are looked up by 2^64 divided by the golden ratio, which spreads keys
 * that differ in few bits. */
#define SPREAD UINT64_C(0x9E3779B97F4A7C15)

/* The bin of a step in a histogram: one for steps of less than 1,024 ns, then 128 for each power of
 * two; the last one has all longer steps, too. */
CANSER_INLINE size_t step_bin(uint64_t step)
{
    const double value = (double)(int64_t)(step > INT64_MAX ? INT64_MAX : step);
    int64_t bits;

    memcpy(&bits, &value, sizeof bits);
    bits = (bits >> 45) - ((INT64_C(1023) + 10) << 7) + 1;
    if (bits < 0)
        return 0;
    return bits < CANSER_STEP_BINS ? (size_t)bits : CANSER_STEP_BINS - 1;
}

CANSER_INLINE void count_in_bin(uint64_t *bins, uint64_t step)
{
    uint64_t *const bin = bins + 2 * step_bin(step);

    bin[0]++;
    bin[1] += step;
}

CANSER_COLD void turn_into_histogram(canser_ids *self, canser_id *row)
{
    uint64_t *const list = self->lists[row->list - 1];
    uint64_t *const bins = self->lists[self->list_count];

    for (size_t i = 0; i < CANSER_STEP_LIST; i++)
        count_in_bin(bins, list[i]);
    memset(list, 0, CANSER_STEP_LIST * sizeof *list);
    self->lists[row->list - 1] = bins;
    self->lists[self->list_count] = list;
    row->listed++;
}

CANSER_INLINE void keep_step(canser_ids *self, canser_id *row, uint64_t step)
{
    if (row->listed < CANSER_EARLY_STEPS) {
        row->early[row->listed++] = step;
        return;
    }
    if (!row->list) {
        row->list = (uint32_t)++self->list_count;
        memcpy(self->lists[row->list - 1], row->early, sizeof row->early);
    }
    if (row->listed == CANSER_STEP_LIST)
        turn_into_histogram(self, row);
    if (row->listed > CANSER_STEP_LIST)
        count_in_bin(self->lists[row->list - 1], step);
    else
        self->lists[row->list - 1][row->listed++] = step;
}

/* Where the rows are looked up. A copy of this stays in registers. */
typedef struct {
    canser_id *rows;
    uint32_t *slots;
    size_t last_slot; /* one less than their number, which is a power of two */
    uint64_t spread;
    unsigned shift;
} row_table;

CANSER_INLINE row_table table_of(const canser_ids *self)
{
    return (row_table){self->rows, self->slots, self->slot_cap - 1,
                       self->spread ? self->spread : SPREAD, place_shift(self->slot_cap, 64)};
}

/* Return where the number of the row of a key stands; or where it is to be put: 0 is there. */
CANSER_INLINE uint32_t *find_slot(row_table table, uint64_t key)
{
    size_t at = (size_t)(key * table.spread >> table.shift);

    while (table.slots[at] && load(&table.rows[table.slots[at] - 1]) != key)
        at = (at + 1) & table.last_slot;
    return &table.slots[at];
}

/* The sum of a row's steps. */
CANSER_INLINE uint64_t row_sum(const canser_id *row)
{
    return row->sum + run_step(row->base, row->last);
}

CANSER_INLINE uint64_t row_most(const canser_id *row)
{
    return row->least + row->spread;
}

/* The dlc of the row's last frame. */
CANSER_INLINE uint8_t row_dlc(const canser_id *row)
{
    return row->head[offsetof(canser_frame, dlc)];
}

CANSER_COLD void add_row(canser_ids *self, uint32_t *slot, uint64_t key, const canser_frame *frame)
{
    canser_id *const row = &self->rows[self->row_count++];

    *slot = (uint32_t)self->row_count;
    memset(row, 0, sizeof *row);
    memcpy(row, &key, sizeof key);
    memcpy(row->data, frame->data, sizeof row->data);
    memcpy(row->head, frame, sizeof row->head);
    row->first = row->last = row->base = CANSER_NO_TIME;
    row->least = INT64_MAX;
    row->run = RUN_NONE;
}

/* Count a frame that differs from those before it: in its dlc, its run, a step out of their range,
 * a bit that did not move yet; or that is a remote frame. So the usual frame needs few comparisons
 * and stores. */
CANSER_NOINLINE int64_t count_other(canser_id *row, const canser_frame *frame, uint32_t run)
{
    const uint64_t step = run_step(row->last, frame->ts);
    const uint64_t data = load(frame->data);
    const uint64_t moving = load(row->moving) | (data ^ load(row->data));
    canser_frame head = *frame;

    row->changes += data != load(row->data) || frame->dlc != row_dlc(row);
    memcpy(row->data, &data, sizeof data);
    memcpy(row->moving, &moving, sizeof moving);
    row->dlcs |= UINT32_C(1) << (frame->dlc & 31);
    row->remote += frame->rtr;
    head.rtr = 0; /* no remote frame is usual */
    memcpy(row->head, &head, sizeof row->head);
    if (run == row->run && frame->ts >= row->last && step <= INT64_MAX) {
        const bool is_longest = !row->steps || step > row_most(row);
        const uint64_t most = is_longest ? step : row_most(row);

        row->least = step < row->least ? step : row->least;
        row->spread = most - row->least;
        row->longest_at = is_longest ? row->last : row->longest_at;
        row->steps++;
        row->last = frame->ts;
        return (int64_t)step;
    }
    row->breaks++;
    row->sum = row_sum(row);
    row->run = run ? run : RUN_NONE;
    row->last = run ? frame->ts : row->last;
    row->base = row->last;
    row->first = row->first == CANSER_NO_TIME ? row->last : row->first;
    return CANSER_NO_STEP;
}

/* Whether a frame is as those before it in its row. */
CANSER_INLINE bool is_usual(const canser_id *row, const canser_frame *frame, uint32_t run)
{
    const uint64_t moving = load(row->moving);

    return load(frame) == load(row->head) && run == row->run &&
           run_step(row->last, frame->ts) - row->least <= row->spread &&
           ((load(frame->data) ^ load(row->data)) | moving) == moving;
}

/* Count such a frame; return the step from the frame before it. */
CANSER_INLINE int64_t count_usual(canser_id *row, const canser_frame *frame)
{
    const uint64_t data = load(frame->data);
    const uint64_t step = run_step(row->last, frame->ts);

    row->changes += data != load(row->data);
    memcpy(row->data, &data, sizeof data);
    row->steps++;
    row->last = frame->ts;
    return (int64_t)step;
}

/* Whether there is room for a new row, and for a list. */
CANSER_INLINE bool has_row_room(const canser_ids *self)
{
    return self->row_count < self->row_cap || self->row_cap >= self->row_most;
}

CANSER_INLINE bool has_list_room(const canser_ids *self, const canser_id *row)
{
    return row->list || row->listed < CANSER_EARLY_STEPS || self->list_count + 1 < self->list_cap;
}

/* What is told of a frame that was counted. */
typedef struct {
    bool has_room;   /* false: nothing was counted, as there is no room for a new row or list */
    uint32_t number; /* that of the row, from 1 on; 0: there is none */
    int64_t step;    /* from the frame before it, or CANSER_NO_STEP */
} counted;

/* Count any frame: in its row, which may be new, and in the runs. */
CANSER_NOINLINE counted count_frame(canser_ids *self, const canser_frame *frame, uint64_t key,
                                    bool keeps_steps)
{
    canser_runs *const runs = &self->runs;
    uint32_t *const slot = find_slot(table_of(self), key);
    const bool is_new = !*slot;
    uint32_t run = runs->run;
    int64_t step = CANSER_NO_STEP;

    if (is_new ? !has_row_room(self) : keeps_steps && !has_list_room(self, &self->rows[*slot - 1]))
        return (counted){false, 0, step};
    if (run_is_near(runs->last, frame->ts, runs_near(runs))) {
        runs->last = frame->ts;
        runs->steps++;
    } else {
        run = runs_next(runs, frame->ts);
    }
    if (is_new && self->row_count < self->row_most)
        add_row(self, slot, key, frame);
    if (!*slot)
        self->others++;
    else if (is_new || !is_usual(&self->rows[*slot - 1], frame, run))
        step = count_other(&self->rows[*slot - 1], frame, run);
    else
        step = count_usual(&self->rows[*slot - 1], frame);
    return (counted){true, *slot, step};
}

CANSER_INLINE size_t add_frames(canser_ids *self, const canser_frame *frames, size_t frame_count,
                                const uint8_t *channels, uint32_t *row_of, int64_t *steps,
                                bool keeps_steps)
{
    canser_runs *const runs = &self->runs;
    const row_table table = table_of(self);
    const uint64_t mask = key_mask(self->is_remote_apart);
    uint64_t near = runs_near(runs);
    int64_t last = runs->last;
    uint32_t run = runs->run;
    size_t begin = 0; /* frames from here on are not in `runs` yet, as all are usual */
    size_t i;

    for (i = 0; i < frame_count; i++) {
        const canser_frame *const frame = &frames[i];
        const uint8_t channel = channels ? channels[i] : CANSER_NO_CHANNEL;
        const uint64_t key = make_key(frame, mask, channel);
        uint32_t number = *find_slot(table, key);
        canser_id *const row = &table.rows[number ? number - 1 : 0];
        int64_t step;

        if (CANSER_LIKELY(number && is_usual(row, frame, run) &&
                          run_is_near(last, frame->ts, near) &&
                          (!keeps_steps || has_list_room(self, row)))) {
            step = count_usual(row, frame);
            last = frame->ts;
        } else {
            counted one;

            runs->last = last;
            runs->steps += i - begin;
            one = count_frame(self, frame, key, keeps_steps);
            number = one.number;
            step = one.step;
            near = runs_near(runs);
            last = runs->last;
            run = runs->run;
            begin = i + 1;
            if (!one.has_room) {
                begin = i;
                break;
            }
        }
        if (keeps_steps && step >= 0)
            keep_step(self, &table.rows[number - 1], (uint64_t)step);
        if (row_of)
            row_of[i] = number - 1; /* CANSER_NO_ROW if there is none */
        if (steps)
            steps[i] = step;
    }
    runs->last = last;
    runs->steps += i - begin;
    return i;
}

static bool is_sized(const canser_ids *self)
{
    const size_t cap = self->slot_cap;

    return cap > 1 && !(cap & (cap - 1)) && cap / 2 >= self->row_cap && cap < CANSER_NO_ROW;
}

static int check(const canser_ids *self, const canser_frame *frames, size_t frame_count,
                 size_t *used)
{
    if (used)
        *used = 0;
    if (!self || !used || !self->slots || (!self->rows && self->row_cap) ||
        (!frames && frame_count))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    return is_sized(self) ? CANSER_OK : CANSER_RANGE;
}

int canser_ids_add(canser_ids *self, const canser_frame *frames, size_t frame_count,
                   const uint8_t *channels, uint32_t *row_of, int64_t *steps, size_t *used)
{
    const int status = check(self, frames, frame_count, used);

    if (status)
        return status;
    if (misaligned(steps, _Alignof(int64_t)))
        return CANSER_MISALIGNED;
    /* Each of these is compiled alone. */
    if (self->lists)
        *used = add_frames(self, frames, frame_count, channels, row_of, steps, true);
    else if (!channels && !row_of && !steps)
        *used = add_frames(self, frames, frame_count, NULL, NULL, NULL, false);
    else
        *used = add_frames(self, frames, frame_count, channels, row_of, steps, false);
    return CANSER_OK;
}

/* Return the number of a frame's row, a new one if need be; 0 if there is no room. */
CANSER_INLINE uint32_t find_row(canser_ids *self, row_table table, uint64_t mask,
                                const canser_frame *frame, uint8_t channel)
{
    const uint64_t key = make_key(frame, mask, channel);
    uint32_t *const slot = find_slot(table, key);

    if (!CANSER_LIKELY(*slot) && self->row_count < self->row_cap) {
        add_row(self, slot, key, frame);
        memset(table.rows[*slot - 1].head, 0xFF, sizeof table.rows->head); /* like no frame's */
    }
    return *slot;
}

int canser_ids_group(canser_ids *self, const canser_frame *frames, size_t frame_count,
                     const uint8_t *channels, uint32_t *row_of, size_t *used)
{
    const int status = check(self, frames, frame_count, used);
    row_table table;
    uint64_t mask;
    size_t i;

    if (status)
        return status;
    if (!row_of && frame_count)
        return CANSER_NULL;
    table = table_of(self);
    mask = key_mask(self->is_remote_apart);
    for (i = 0; i < frame_count; i++) {
        const uint8_t channel = channels ? channels[i] : CANSER_NO_CHANNEL;
        const uint32_t number = find_row(self, table, mask, &frames[i], channel);

        if (!number)
            break;
        table.rows[number - 1].breaks++;
        row_of[i] = number - 1;
    }
    *used = i;
    return CANSER_OK;
}

int canser_ids_fill_slots(canser_ids *self)
{
    if (!self || !self->slots || (!self->rows && self->row_count))
        return CANSER_NULL;
    if (!is_sized(self))
        return CANSER_RANGE;
    for (size_t i = 0; i < self->row_count; i++)
        *find_slot(table_of(self), load(&self->rows[i])) = (uint32_t)(i + 1);
    return CANSER_OK;
}

/* Whether each row has its place in `out`. */
static bool are_places(const int64_t *next, const int64_t *ends, size_t row_count, size_t out_cap)
{
    for (size_t i = 0; i < row_count; i++)
        if (next[i] < 0 || next[i] > ends[i] || (uint64_t)ends[i] > out_cap)
            return false;
    return true;
}

/* Put each frame's number, or its step, behind those of its row. */
CANSER_INLINE int scatter(const uint32_t *row_of, const int64_t *steps, size_t frame_count,
                          int64_t *next, const int64_t *ends, size_t row_count, int64_t *out)
{
    for (size_t i = 0; i < frame_count; i++) {
        const uint32_t row = row_of[i];

        if (row == CANSER_NO_ROW || (steps && steps[i] < 0))
            continue;
        if (row >= row_count || next[row] == ends[row])
            return CANSER_RANGE;
        out[next[row]++] = steps ? steps[i] : (int64_t)i;
    }
    return CANSER_OK;
}

int canser_order_rows(const uint32_t *row_of, const int64_t *steps, size_t frame_count,
                      int64_t *next, const int64_t *ends, size_t row_count, int64_t *out,
                      size_t out_cap)
{
    if ((!row_of && frame_count) || ((!next || !ends) && row_count) || (!out && out_cap))
        return CANSER_NULL;
    if (!are_places(next, ends, row_count, out_cap))
        return CANSER_RANGE;
    return steps ? scatter(row_of, steps, frame_count, next, ends, row_count, out)
                 : scatter(row_of, NULL, frame_count, next, ends, row_count, out);
}

int canser_runs_add(canser_runs *self, const canser_frame *frames, size_t frame_count,
                    uint32_t *run_of)
{
    if (!self || ((!frames || !run_of) && frame_count))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    for (size_t i = 0; i < frame_count; i++) {
        const uint32_t left = self->since ? self->run_before : 0;

        run_of[i] = runs_next(self, frames[i].ts);
        /* Back in the run before: the times since the jump were false. */
        if (left && run_of[i] == left)
            for (size_t j = i; j-- && run_of[j] != left;)
                run_of[j] = 0;
    }
    return CANSER_OK;
}
