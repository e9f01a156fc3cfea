/* Signals: the numbers that a database finds in the data of frames.
 *
 * Frames are counted first, so that each column gets just the room that it needs. Then each frame's
 * data and time go to the groups of its message, and of the pages that its multiplexers select.
 * When a group has a block of them, each of its signals is decoded in a loop of its own, in which
 * nothing depends on the frame. */
#include "past.h"

#if CANSER_HAS_PAST
#include <immintrin.h>
#endif

#define BLOCK CANSER_SIGNAL_BLOCK

/* Columns of more bytes together do not stay in the cache, and are stored past it. */
#define PAST_FROM (UINT64_C(16) << 20)

CANSER_INLINE uint64_t swapped_word(uint64_t word)
{
    word = (word & UINT64_C(0x00ff00ff00ff00ff)) << 8 | (word >> 8 & UINT64_C(0x00ff00ff00ff00ff));
    word =
        (word & UINT64_C(0x0000ffff0000ffff)) << 16 | (word >> 16 & UINT64_C(0x0000ffff0000ffff));
    return word << 32 | word >> 32;
}

/* Eight bytes, as they lie in memory, as a number whose lowest byte is the first one; the last one
 * if `is_big`. */
CANSER_INLINE uint64_t number_of(uint64_t word, bool is_big)
{
    return is_big != CANSER_BIG_ENDIAN ? swapped_word(word) : word;
}

/* ---- Numbers out of a block of data. */

CANSER_INLINE uint64_t unsigned_of(const canser_field *field, uint64_t number)
{
    return number >> field->shift & UINT64_MAX >> (64 - field->bit_count);
}

CANSER_INLINE int64_t signed_of(const canser_field *field, uint64_t number)
{
    return (int64_t)(number << (64 - field->shift - field->bit_count)) >> (64 - field->bit_count);
}

CANSER_INLINE uint64_t value_of(const canser_field *field, uint64_t word)
{
    const uint64_t number = number_of(word, field->is_big);

    return field->is_signed ? (uint64_t)signed_of(field, number) : unsigned_of(field, number);
}

/* Numbers of up to 31 bits, with which processors have faster ways to float64 and to 64 bits. */
CANSER_INLINE int32_t short_unsigned(uint64_t number, unsigned shift, unsigned rest)
{
    return (int32_t)((uint32_t)(number >> shift) & UINT32_MAX >> rest);
}

CANSER_INLINE int32_t short_signed(uint64_t number, unsigned shift, unsigned rest)
{
    return (int32_t)((uint32_t)(number >> shift) << rest) >> rest;
}

/* A half-precision number is its fraction times a power of two. */
static double of_float16(uint32_t bits)
{
    const uint32_t exponent = bits >> 10 & 31;
    const uint32_t fraction = bits & 0x3ff;
    uint64_t wide = (uint64_t)(bits >> 15) << 63 | (uint64_t)fraction << 42;
    double value;

    if (exponent == 0) {
        value = (double)fraction * 0x1p-24;
        return bits >> 15 ? -value : value;
    }
    wide |= (uint64_t)(exponent == 31 ? 0x7ff : exponent + 1008) << 52;
    memcpy(&value, &wide, sizeof value);
    return value;
}

CANSER_INLINE double of_float32(uint32_t bits)
{
    float value;

    memcpy(&value, &bits, sizeof value);
    return (double)value;
}

CANSER_INLINE double of_float64(uint64_t bits)
{
    double value;

    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Fill `out`: `number` is that of the block's element i. */
#define FILL(type, value)                                                                          \
    do {                                                                                           \
        type *const restrict to = out;                                                             \
                                                                                                   \
        for (size_t i = 0; i < count; i++) {                                                       \
            const uint64_t number = numbers[i];                                                    \
                                                                                                   \
            to[i] = (value);                                                                       \
        }                                                                                          \
    } while (0)

static void fill_whole(const canser_signal *signal, const uint64_t *restrict numbers, size_t count,
                       void *restrict out)
{
    const canser_field field = signal->field;
    const unsigned shift = field.shift;
    const unsigned rest = 32U - field.bit_count;
    const uint64_t scale = (uint64_t)signal->scale;
    const uint64_t offset = (uint64_t)signal->offset;
    const bool is_plain = signal->is_raw || (scale == 1 && offset == 0);

    if (field.bit_count > 31) {
        const uint64_t factor = is_plain ? 1 : scale;
        const uint64_t addend = is_plain ? 0 : offset;

        if (field.is_signed)
            FILL(uint64_t, (uint64_t)signed_of(&field, number) * factor + addend);
        else
            FILL(uint64_t, unsigned_of(&field, number) * factor + addend);
    } else if (is_plain) {
        if (field.is_signed)
            FILL(int64_t, short_signed(number, shift, rest));
        else
            FILL(int64_t, short_unsigned(number, shift, rest));
    } else if (field.is_signed) {
        FILL(uint64_t, (uint64_t)short_signed(number, shift, rest) * scale + offset);
    } else {
        FILL(uint64_t, (uint64_t)short_unsigned(number, shift, rest) * scale + offset);
    }
}

static void fill_scaled(const canser_signal *signal, const uint64_t *restrict numbers, size_t count,
                        void *restrict out)
{
    const canser_field field = signal->field;
    const unsigned shift = field.shift;
    const unsigned rest = 32U - field.bit_count;
    const double factor = signal->factor;
    const double addend = signal->addend;

    if (field.bit_count > 31) {
        if (field.is_signed)
            FILL(double, (double)signed_of(&field, number) * factor + addend);
        else if (field.bit_count < 64) /* which needs fewer instructions */
            FILL(double, (double)(int64_t)unsigned_of(&field, number) * factor + addend);
        else
            FILL(double, (double)number *factor + addend);
    } else if (field.is_signed) {
        FILL(double, (double)short_signed(number, shift, rest) * factor + addend);
    } else {
        FILL(double, (double)short_unsigned(number, shift, rest) * factor + addend);
    }
}

static void fill_float(const canser_signal *signal, const uint64_t *restrict numbers, size_t count,
                       void *restrict out)
{
    const canser_field field = signal->field;
    const unsigned shift = field.shift;
    double *const restrict values = out;

    if (signal->kind == CANSER_SIGNAL_FLOAT64)
        FILL(double, of_float64(number));
    else if (signal->kind == CANSER_SIGNAL_FLOAT32)
        FILL(double, of_float32((uint32_t)(number >> shift)));
    else
        FILL(double, of_float16((uint32_t)(number >> shift) & 0xffff));
    if (!signal->is_raw && (signal->factor != 1 || signal->addend != 0))
        for (size_t i = 0; i < count; i++)
            values[i] = values[i] * signal->factor + signal->addend;
}

#if CANSER_HAS_PAST
CANSER_INLINE bool has_avx2(void)
{
    return __builtin_cpu_supports("avx2");
}

/* Fill a column whose numbers have up to 31 bits, past the cache: as fill_scaled(), without a room
 * between. For processors with AVX2. Returns how many elements are filled, up to 7 less than
 * `count`; or 0. */
__attribute__((target("avx2"))) static size_t fill_past(const canser_signal *signal,
                                                        const uint64_t *restrict numbers,
                                                        size_t count, uint64_t *column)
{
    const __m128i shift = _mm_cvtsi32_si128(signal->field.shift);
    const __m128i rest = _mm_cvtsi32_si128(32 - signal->field.bit_count);
    const __m256d factor = _mm256_set1_pd(signal->factor);
    const __m256d addend = _mm256_set1_pd(signal->addend);
    const bool is_signed = signal->field.is_signed;
    size_t i;

    if (signal->field.bit_count > 31 || (uintptr_t)column % 32)
        return 0;
    for (i = 0; i + 8 <= count; i += 8) {
        const __m256i *const from = (const __m256i *)(const void *)(numbers + i);
        double *const to = (double *)column + i;
        const __m256i low = _mm256_srl_epi64(_mm256_loadu_si256(from), shift);
        const __m256i high = _mm256_srl_epi64(_mm256_loadu_si256(from + 1), shift);
        __m256i eight = _mm256_castps_si256(_mm256_shuffle_ps(
            _mm256_castsi256_ps(low), _mm256_castsi256_ps(high), _MM_SHUFFLE(2, 0, 2, 0)));
        __m256d four;

        eight = _mm256_sll_epi32(eight, rest);
        eight = is_signed ? _mm256_sra_epi32(eight, rest) : _mm256_srl_epi32(eight, rest);
        eight = _mm256_permute4x64_epi64(eight, _MM_SHUFFLE(3, 1, 2, 0)); /* in their order */
        four = _mm256_cvtepi32_pd(_mm256_castsi256_si128(eight));
        _mm256_stream_pd(to, _mm256_add_pd(_mm256_mul_pd(four, factor), addend));
        four = _mm256_cvtepi32_pd(_mm256_extracti128_si256(eight, 1));
        _mm256_stream_pd(to + 4, _mm256_add_pd(_mm256_mul_pd(four, factor), addend));
    }
    return i;
}
#else
CANSER_INLINE bool has_avx2(void)
{
    return false;
}

CANSER_INLINE size_t fill_past(const canser_signal *signal, const uint64_t *numbers, size_t count,
                               uint64_t *column)
{
    (void)signal, (void)numbers, (void)count, (void)column;
    return 0;
}
#endif

/* Let a group's block take as many samples as the group has room for. */
CANSER_INLINE void empty_block(canser_group *group)
{
    const size_t room = group->cap - group->count;

    group->cursor.next = group->block;
    group->cursor.end = group->block + (room < BLOCK ? room : BLOCK);
}

/* Decode what is in the block of a group, and empty it. */
static void decode_block(const canser_database *self, canser_group *group)
{
    uint64_t swapped[BLOCK];
    const uint64_t *const data = group->block;
    const size_t count = (size_t)(group->cursor.next - data);
    bool is_swapped = false;
    union {
        uint64_t words[BLOCK];
        double numbers[BLOCK];
    } room;

    if (self->is_past)
        copy_past((uint64_t *)group->ts + group->count, data + BLOCK, count);
    else
        memcpy(group->ts + group->count, data + BLOCK, 8 * count);
    for (size_t i = 0; i < group->signal_count; i++) {
        const canser_signal *const signal = &self->signals[group->first_signal + i];
        uint64_t *const column = (uint64_t *)signal->values + group->count;
        void *const out = self->is_past ? (void *)&room : column;
        const uint64_t *numbers = data;
        size_t done = 0;

        if (signal->field.is_big != CANSER_BIG_ENDIAN) {
            for (size_t j = 0; !is_swapped && j < count; j++)
                swapped[j] = swapped_word(data[j]);
            is_swapped = true;
            numbers = swapped;
        }
        if (self->is_wide && signal->kind == CANSER_SIGNAL_SCALED)
            done = fill_past(signal, numbers, count, column);
        if (signal->kind == CANSER_SIGNAL_SCALED)
            fill_scaled(signal, numbers + done, count - done, out);
        else if (signal->kind == CANSER_SIGNAL_WHOLE)
            fill_whole(signal, numbers, count, out);
        else
            fill_float(signal, numbers, count, out);
        if (self->is_past)
            copy_past(column + done, room.words, count - done);
    }
    group->count += count;
    empty_block(group);
}

/* Keep a frame in a block with room for it. */
CANSER_INLINE void keep(canser_cursor *cursor, const canser_frame *frame)
{
    uint64_t *const next = cursor->next;

    next[0] = load_word(frame->data);
    next[BLOCK] = (uint64_t)frame->ts;
    cursor->next = next + 1;
}

/* Keep a frame for a group. Returns false if the group has no room. */
CANSER_INLINE bool keep_for(const canser_database *self, canser_group *group,
                            const canser_frame *frame)
{
    if (group->cursor.next == group->cursor.end) {
        decode_block(self, group);
        if (group->cursor.next == group->cursor.end)
            return false;
    }
    keep(&group->cursor, frame);
    return true;
}

/* ---- The message of a frame. */

CANSER_INLINE uint32_t key_of(const canser_frame *frame)
{
    return frame->id | (uint32_t)frame->ext << 31;
}

/* Where ids are looked up. A copy of this stays in registers. */
typedef struct {
    canser_known_id *ids;
    size_t cap;
    uint32_t spread;
    unsigned shift;
} id_table;

CANSER_INLINE id_table table_of(const canser_database *self)
{
    return (id_table){self->ids, self->id_cap, self->spread, place_shift(self->id_cap, 32)};
}

/* Return where an id is looked for first. */
CANSER_INLINE size_t home_of(id_table table, uint32_t key)
{
    return (uint32_t)(key * table.spread) >> table.shift;
}

/* Return the place of an id: its own, or a free one. */
CANSER_INLINE canser_known_id *find_id(id_table table, uint32_t key)
{
    size_t at = home_of(table, key);

    while (table.ids[at].key != key && table.ids[at].page)
        at = (at + 1) & (table.cap - 1);
    return &table.ids[at];
}

/* Return the page of the parameter group of an extended id and one more, or CANSER_NO_MESSAGE. */
CANSER_COLD uint32_t find_pgn(const canser_database *self, uint32_t id)
{
    uint32_t pgn = id >> 8 & 0x3ffff;
    size_t low = 0;
    size_t high = self->pgn_count;

    if ((pgn >> 8 & 0xff) < 240)
        pgn &= 0x3ff00;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;

        if (self->pgns[middle].pgn < pgn)
            low = middle + 1;
        else
            high = middle;
    }
    return low < self->pgn_count && self->pgns[low].pgn == pgn ? self->pgns[low].page + 1
                                                               : CANSER_NO_MESSAGE;
}

/* Whether a frame may have a message: a data frame, with an id of at most 29 bits. */
CANSER_INLINE bool is_usual(const canser_frame *frame)
{
    return !(frame->err | frame->rtr | (frame->id >> 29));
}

CANSER_INLINE uint32_t dlc_of(const canser_frame *frame)
{
    return frame->dlc > 8 ? 8 : frame->dlc;
}

/* ---- Multiplexers. */

/* Return the case of a multiplexer's value, or NULL. */
static const canser_case *find_case(const canser_database *self, const canser_mux *mux,
                                    uint64_t value)
{
    const canser_case *const cases = self->cases + mux->first_case;
    size_t low = 0;
    size_t high = mux->case_count;

    if (mux->table != CANSER_NO_TABLE) {
        const uint32_t number = value < 256 ? self->tables[mux->table + value] : 0;

        return number ? &cases[number - 1] : NULL;
    }
    while (low < high) {
        const size_t middle = low + (high - low) / 2;

        if (cases[middle].high < value)
            low = middle + 1;
        else
            high = middle;
    }
    return low < mux->case_count && cases[low].low <= value ? &cases[low] : NULL;
}

/* What a frame lacks. */
typedef struct {
    bool is_short;
    bool is_unknown;
} lack;

/* Count a frame in a page, and in all pages that it selects. */
static void count_page(canser_database *self, uint32_t number, const canser_frame *frame,
                       lack *found)
{
    canser_page *const page = &self->pages[number];
    const uint32_t dlc = dlc_of(frame);

    self->dlcs[9 * (size_t)number + dlc]++;
    found->is_short |= dlc < page->full_dlc;
    for (uint32_t i = 0; i < page->mux_count; i++) {
        const canser_mux *const mux = &self->muxes[page->first_mux + i];
        const canser_case *chosen;

        if (dlc < mux->least_dlc)
            continue;
        chosen = find_case(self, mux, value_of(&mux->field, load_word(frame->data)));
        if (!chosen) {
            found->is_unknown = true;
            continue;
        }
        for (uint32_t link = 0; link < chosen->link_count; link++)
            count_page(self, self->links[chosen->first_link + link], frame, found);
    }
}

/* Keep a frame for the groups of a page, and of all pages that it selects. Returns false if a group
 * has no room. */
static bool keep_page(canser_database *self, uint32_t number, const canser_frame *frame)
{
    const canser_page *const page = &self->pages[number];
    const uint32_t dlc = dlc_of(frame);

    for (uint32_t i = 0; i < page->group_count; i++) {
        canser_group *const group = &self->groups[page->first_group + i];

        if (dlc < group->least_dlc)
            break;
        if (!keep_for(self, group, frame))
            return false;
    }
    for (uint32_t i = 0; i < page->mux_count; i++) {
        const canser_mux *const mux = &self->muxes[page->first_mux + i];
        const canser_case *chosen;

        if (dlc < mux->least_dlc)
            continue;
        chosen = find_case(self, mux, value_of(&mux->field, load_word(frame->data)));
        for (uint32_t link = 0; chosen && link < chosen->link_count; link++)
            if (!keep_page(self, self->links[chosen->first_link + link], frame))
                return false;
    }
    return true;
}

/* ---- The public functions. */

/* Whether a table of ids may have this many places. */
CANSER_INLINE bool is_fit(size_t id_cap)
{
    return id_cap > 1 && !(id_cap & (id_cap - 1)) && id_cap <= UINT32_MAX / 2 + 1;
}

static int check(const canser_database *self, const canser_frame *frames, const uint16_t *routes,
                 size_t frame_count)
{
    if (!self || ((!frames || !routes) && frame_count) || !self->ids)
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    if (!is_fit(self->id_cap) || self->id_count >= self->id_cap)
        return CANSER_RANGE;
    return CANSER_OK;
}

/* Find the page of a frame whose id is not in the table, and one more; keep the id. Returns false
 * if there is no place for it. */
CANSER_COLD bool add_id(canser_database *self, const canser_frame *frame, uint32_t *page)
{
    *page = frame->ext ? find_pgn(self, frame->id) : CANSER_NO_MESSAGE;
    if (self->id_count >= self->id_most) {
        self->other_count += *page == CANSER_NO_MESSAGE;
        return true;
    }
    if (2 * (self->id_count + 1) > self->id_cap)
        return false;
    self->id_count++;
    *find_id(table_of(self), key_of(frame)) =
        (canser_known_id){.head = CANSER_NO_HEAD,
                          .key = key_of(frame),
                          .page = *page,
                          .count = *page == CANSER_NO_MESSAGE};
    return true;
}

CANSER_INLINE uint16_t route_to(uint32_t page)
{
    return (uint16_t)(page < CANSER_FAR_ROUTE ? page : CANSER_FAR_ROUTE);
}

/* Count a frame of any kind, and find its route. Returns false if its id is new, and there is no
 * place for it. */
CANSER_NOINLINE bool count_frame(canser_database *self, id_table table, const canser_frame *frame,
                                 uint16_t *route)
{
    canser_known_id *known;
    canser_page *page;
    uint32_t number;
    lack found = {false, false};

    *route = CANSER_NO_ROUTE;
    if (!is_usual(frame)) {
        self->error_count += frame->err;
        self->remote_count += frame->rtr && !frame->err;
        self->other_count += !frame->rtr && !frame->err;
        return true;
    }
    known = find_id(table, key_of(frame));
    number = known->page;
    if (number == CANSER_NO_MESSAGE) {
        known->count++;
        return true;
    }
    if (!number) {
        if (!add_id(self, frame, &number))
            return false;
        if (number == CANSER_NO_MESSAGE)
            return true;
    }
    number--;
    *route = route_to(number);
    page = &self->pages[number];
    if (!page->mux_count) {
        const size_t counter = 9 * (size_t)number + dlc_of(frame);

        self->dlcs[counter]++;
        /* This may be a free place, if the id is not kept: its frames are found there, too. */
        if (counter <= UINT32_MAX) {
            known->head = load_word((const uint8_t *)frame);
            known->counter = (uint32_t)counter;
            known->route = *route;
        }
        return true;
    }
    count_page(self, number, frame, &found);
    page->short_count += found.is_short;
    page->unknown_count += found.is_unknown;
    return true;
}

int canser_database_count(canser_database *self, const canser_frame *frames, size_t frame_count,
                          uint16_t *routes, size_t *used)
{
    const int status = check(self, frames, routes, frame_count);
    id_table table;
    size_t i = 0;

    if (used)
        *used = 0;
    if (status)
        return status;
    if (!used)
        return CANSER_NULL;
    table = table_of(self);
    for (; i < frame_count; i++) {
        const canser_known_id *const home = &table.ids[home_of(table, key_of(&frames[i]))];

        if (CANSER_LIKELY(home->head == load_word((const uint8_t *)&frames[i]))) {
            self->dlcs[home->counter]++;
            routes[i] = (uint16_t)home->route;
        } else if (!count_frame(self, table, &frames[i], &routes[i])) {
            break;
        }
    }
    *used = i;
    return CANSER_OK;
}

/* Return the page of a frame's message and one more, when its route has no room for it. */
CANSER_COLD uint32_t far_page(const canser_database *self, const canser_frame *frame)
{
    const uint32_t page = find_id(table_of(self), key_of(frame))->page;

    return page || !frame->ext ? page : find_pgn(self, frame->id);
}

/* Whether all frames of a page are for just one group. */
static bool is_simple(const canser_database *self, size_t number)
{
    const canser_page *const page = &self->pages[number];
    uint64_t shorter = 0;

    if (page->group_count != 1 || page->mux_count)
        return false;
    for (size_t dlc = 0; dlc < self->groups[page->first_group].least_dlc; dlc++)
        shorter += self->dlcs[9 * number + dlc];
    return !shorter;
}

/* Keep a frame whose page is not simple, or has no room in its block. Returns false if a group has
 * no room. */
CANSER_NOINLINE bool keep_other(canser_database *self, const canser_frame *frame, uint32_t route)
{
    uint32_t page = route + 1;

    if (route == CANSER_NO_ROUTE)
        return true;
    if (route == CANSER_FAR_ROUTE)
        page = far_page(self, frame);
    return !page || page == CANSER_NO_MESSAGE || keep_page(self, page - 1, frame);
}

/* Whether all columns are too large for the cache. */
static bool is_large(const canser_database *self)
{
    uint64_t words = 0;

    for (size_t i = 0; i < self->group_count; i++)
        words += (uint64_t)self->groups[i].cap * (1 + self->groups[i].signal_count);
    return CANSER_HAS_PAST && words > PAST_FROM / sizeof words;
}

int canser_database_decode(canser_database *self, const canser_frame *frames, size_t frame_count,
                           const uint16_t *routes)
{
    const int status = check(self, frames, routes, frame_count);
    canser_cursor **cursors;
    size_t route_count;
    bool has_room = true;

    if (status)
        return status;
    cursors = self->cursors;
    route_count = self->page_count < CANSER_FAR_ROUTE ? self->page_count : CANSER_FAR_ROUTE;
    self->nowhere = (canser_cursor){NULL, NULL};
    self->is_past = is_large(self);
    self->is_wide = self->is_past && has_avx2();
    for (size_t i = 0; i < self->group_count; i++)
        empty_block(&self->groups[i]);
    for (size_t i = 0; i < route_count; i++)
        cursors[i] =
            is_simple(self, i) ? &self->groups[self->pages[i].first_group].cursor : &self->nowhere;
    for (size_t i = 0; i < frame_count; i++) {
        const uint32_t route = routes[i];

        if (CANSER_LIKELY(route < route_count && cursors[route]->next != cursors[route]->end)) {
            keep(cursors[route], &frames[i]);
        } else if (!keep_other(self, &frames[i], route)) {
            has_room = false;
            break;
        }
    }
    for (size_t i = 0; i < self->group_count; i++)
        decode_block(self, &self->groups[i]);
    if (self->is_past)
        settle_stores();
    return has_room ? CANSER_OK : CANSER_RANGE;
}

int canser_database_move_ids(canser_database *self, canser_known_id *ids, size_t id_cap)
{
    const canser_known_id *before;
    size_t count;
    id_table table;

    if (!self || !ids || !self->ids)
        return CANSER_NULL;
    if (!is_fit(id_cap) || self->id_count >= id_cap)
        return CANSER_RANGE;
    before = self->ids;
    count = self->id_cap;
    self->ids = ids;
    self->id_cap = id_cap;
    table = table_of(self);
    for (size_t i = 0; i < count; i++)
        if (before[i].page)
            *find_id(table, before[i].key) = before[i];
    for (size_t i = 0; i < id_cap; i++)
        ids[i].head = CANSER_NO_HEAD;
    return CANSER_OK;
}
