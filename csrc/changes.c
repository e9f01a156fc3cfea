/* Frames whose payload differs from that of the frame before of their id.
 *
 * A block of frames is compared first, which keeps the numbers of those that differ; then these are
 * copied. So nothing depends on how often payloads change. */
#include "keys.h"
#include "past.h"

/* Frames that are compared before some of them are copied, from the nearest cache. */
enum { BLOCK = 256 };

/* Frames from which on the copies are more than the cache holds. */
enum { PAST_FROM = 1 << 19 };

/* Where the ids are looked up. A copy of this stays in registers. */
typedef struct {
    canser_last *lasts;
    size_t last_place;
    uint64_t spread;
    unsigned shift;
} last_table;

CANSER_INLINE last_table table_of(const canser_changes *self)
{
    return (last_table){self->lasts, self->cap - 1, self->spread, place_shift(self->cap, 64)};
}

/* Return the place of a key: its own, or a free one. */
CANSER_INLINE canser_last *find_last(last_table table, uint64_t key)
{
    size_t at = (size_t)(key * table.spread >> table.shift);

    while (!CANSER_LIKELY(table.lasts[at].key == key) && table.lasts[at].key != CANSER_NO_KEY)
        at = (at + 1) & table.last_place;
    return &table.lasts[at];
}

/* Put a key into a free place. Returns false if half of the places are used. */
CANSER_COLD bool add_key(canser_changes *self, canser_last *place, uint64_t key)
{
    if (2 * (self->count + 1) > self->cap)
        return false;
    self->count++;
    *place = (canser_last){.head = UINT64_MAX, .key = key}; /* no frame begins so */
    return true;
}

/* Compare frames, up to BLOCK; put the numbers of those that change into `changed`. Returns how
 * many are compared: fewer if there is no place for an id. */
CANSER_INLINE size_t compare(canser_changes *self, last_table table, const canser_frame *frames,
                             size_t frame_count, const uint8_t *channels, uint16_t *changed,
                             size_t *changed_count)
{
    const uint64_t mask = key_mask(true);
    size_t count = 0;
    size_t i;

    for (i = 0; i < frame_count; i++) {
        const uint8_t channel = channels ? channels[i] : CANSER_NO_CHANNEL;
        const uint64_t key = make_key(&frames[i], mask, channel);
        const uint64_t head = load(&frames[i]);
        const uint64_t data = load(frames[i].data);
        canser_last *const last = find_last(table, key);

        if (!CANSER_LIKELY(last->key == key) && !add_key(self, last, key))
            break;
        changed[count] = (uint16_t)i; /* which stays only if it is counted */
        count += ((last->head ^ head) | (last->data ^ data)) != 0;
        last->head = head;
        last->data = data;
    }
    *changed_count = count;
    return i;
}

/* Copy the frames that change. */
CANSER_INLINE void copy_changed(canser_frame *out, const canser_frame *frames,
                                const uint16_t *changed, size_t count, bool is_past)
{
    for (size_t i = 0; i < count; i++) {
        const canser_frame *const frame = &frames[changed[i]];

        if (is_past) {
            store_past(&out[i], load(frame));
            store_past(out[i].data, load(frame->data));
            store_past(&out[i].ts, (uint64_t)frame->ts);
        } else {
            out[i] = *frame;
        }
    }
}

static bool is_fit(size_t cap)
{
    return cap > 1 && !(cap & (cap - 1));
}

int canser_changes_add(canser_changes *self, const canser_frame *frames, size_t frame_count,
                       const uint8_t *channels, canser_frame *out, size_t out_cap, size_t *used,
                       size_t *out_count)
{
    const bool is_past = CANSER_HAS_PAST && frame_count > PAST_FROM;
    uint16_t changed[BLOCK];
    last_table table;
    size_t done = 0;
    size_t count = 0;

    if (used)
        *used = 0;
    if (out_count)
        *out_count = 0;
    if (!self || !self->lasts || !used || !out_count || (!frames && frame_count) ||
        (!out && out_cap))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)) || misaligned(out, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    if (!is_fit(self->cap))
        return CANSER_RANGE;
    table = table_of(self);
    while (done < frame_count && count < out_cap) {
        const size_t left =
            frame_count - done < out_cap - count ? frame_count - done : out_cap - count;
        const size_t wanted = left < BLOCK ? left : BLOCK;
        const uint8_t *const told = channels ? channels + done : NULL;
        size_t changed_count;
        const size_t compared =
            told ? compare(self, table, frames + done, wanted, told, changed, &changed_count)
                 : compare(self, table, frames + done, wanted, NULL, changed, &changed_count);

        if (is_past && changed_count == BLOCK)
            copy_past((uint64_t *)(void *)(out + count),
                      (const uint64_t *)(const void *)(frames + done),
                      BLOCK * sizeof *out / sizeof(uint64_t));
        else if (is_past)
            copy_changed(out + count, frames + done, changed, changed_count, true);
        else
            copy_changed(out + count, frames + done, changed, changed_count, false);
        done += compared;
        count += changed_count;
        if (compared < wanted)
            break;
    }
    if (is_past)
        settle_stores();
    *used = done;
    *out_count = count;
    return CANSER_OK;
}

int canser_changes_move(canser_changes *self, canser_last *lasts, size_t cap)
{
    const canser_last *const before = self ? self->lasts : NULL;
    const size_t count = self ? self->cap : 0;
    last_table table;

    if (!self || !lasts)
        return CANSER_NULL;
    if (!is_fit(cap) || self->count > cap / 2)
        return CANSER_RANGE;
    for (size_t i = 0; i < cap; i++)
        lasts[i].key = CANSER_NO_KEY;
    self->lasts = lasts;
    self->cap = cap;
    table = table_of(self);
    for (size_t i = 0; before && i < count; i++)
        if (before[i].key != CANSER_NO_KEY)
            *find_last(table, before[i].key) = before[i];
    return CANSER_OK;
}
