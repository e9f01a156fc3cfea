/* Signals: each value as it is bit by bit, for every field, multiplexer and length of a frame; no
 * byte touched past an array; and the errors of each call.
 *
 *     signals [rounds]
 */
#include "guarded.h"

#include "canser.h"
#include "checks.h"

#include <float.h>
#include <string.h>

enum { FRAMES = 20000, MESSAGES = 5, GROUPS = 3 * MESSAGES, SIGNALS = 4 * GROUPS, CASES = 4 };
enum { BLOCK_BYTES = 2 * CANSER_SIGNAL_BLOCK * sizeof(uint64_t) };

/* A database. Message i has the page 3 i; if it has a multiplexer, its values select the two pages
 * behind, one by even cases and both by the last one. Each page has one group. */
static canser_known_id ids[MESSAGES], places[16384];
static canser_page pages[GROUPS];
static uint64_t dlcs[9 * GROUPS];
static canser_cursor *cursors[GROUPS];
static canser_mux muxes[MESSAGES];
static canser_case cases[MESSAGES * CASES];
static uint32_t links[4 * MESSAGES];
static uint16_t tables[256 * MESSAGES];
static canser_pgn pgn;
static canser_group groups[GROUPS + 1]; /* and one that no page has */
static canser_signal signals[SIGNALS];
static canser_database database;

static canser_frame *frames;
static uint16_t *routes;
static size_t frame_count;

static canser_field random_field(void)
{
    canser_field field;

    field.is_big = random_below(2) != 0;
    field.is_signed = random_below(2) != 0;
    field.bit_count = (uint8_t)(1 + random_below(random_below(2) ? 64 : 34));
    field.shift = (uint8_t)random_below(65U - field.bit_count);
    return field;
}

static canser_signal random_signal(void)
{
    const double factors[] = {1, 0.1, -3, 1e-9, 250};
    canser_signal signal;

    memset(&signal, 0, sizeof signal);
    signal.field = random_field();
    signal.kind = (uint8_t)(CANSER_SIGNAL_WHOLE + random_below(5));
    if (signal.kind >= CANSER_SIGNAL_FLOAT16) {
        signal.field.bit_count = (uint8_t)(16 << (signal.kind - CANSER_SIGNAL_FLOAT16));
        signal.field.shift = (uint8_t)random_below(65U - signal.field.bit_count);
    }
    signal.factor = factors[random_below(5)];
    signal.addend = random_below(2) ? -40.05 : 0;
    signal.scale = random_below(2) ? 1 : (int64_t)random_word();
    signal.offset = random_below(2) ? 0 : (int64_t)random_word();
    signal.is_raw = random_below(4) == 0;
    return signal;
}

/* Bytes that a frame needs to have all bits of a field. */
static uint32_t least_dlc(const canser_field *field)
{
    const unsigned bits =
        field->is_big ? 64U - field->shift : (unsigned)field->shift + field->bit_count;

    return (bits + 7) / 8;
}

static void make_database(void)
{
    memset(&database, 0, sizeof database);
    memset(pages, 0, sizeof pages);
    memset(dlcs, 0, sizeof dlcs);
    memset(groups, 0, sizeof groups);
    memset(tables, 0, sizeof tables);
    for (uint32_t i = 0; i < MESSAGES; i++) {
        canser_mux *const mux = &muxes[i];

        /* The last message is found by its parameter group only. None has the id 0, whose frames
         * may begin with 8 bytes of 0. */
        const uint32_t id = i == 4 ? 0x1fffffff : i == 0 ? 2 : i / 2;

        ids[i] = (canser_known_id){.key = id | i % 2 << 31, .page = 3 * i + 1};
        pages[3 * i].first_mux = i;
        pages[3 * i].mux_count = i > 1;
        mux->field = random_field();
        mux->field.bit_count = (uint8_t)(1 + random_below(i == 2 ? 8 : 16));
        mux->field.shift = (uint8_t)random_below(65U - mux->field.bit_count);
        mux->least_dlc = least_dlc(&mux->field);
        mux->first_case = CASES * i;
        mux->case_count = CASES;
        mux->table = i == 2 ? 256 * i : CANSER_NO_TABLE;
        for (uint32_t j = 0; j < CASES; j++) {
            const bool is_last = j == CASES - 1;
            const uint64_t low = 3 * j, high = is_last ? 3 * j + 100 : 3 * j + j % 2;

            cases[CASES * i + j] = (canser_case){low, high, 4 * i + j % 2, is_last ? 2 : 1};
            if (mux->table != CANSER_NO_TABLE)
                for (uint64_t value = low; value <= high; value++)
                    tables[mux->table + value] = (uint16_t)(j + 1);
        }
        for (uint32_t j = 0; j < 4; j++)
            links[4 * i + j] = 3 * i + 1 + j % 2;
        /* The last case has the links 1 and 2: pages 3 i + 2 and 3 i + 1. */
    }
    for (uint32_t i = 0; i < GROUPS; i++) {
        canser_group *const group = &groups[i];

        group->first_signal = 4 * i;
        group->signal_count = 1 + (uint32_t)random_below(4);
        pages[i].first_group = i;
        pages[i].group_count = 1;
        for (uint32_t j = 0; j < group->signal_count; j++) {
            signals[4 * i + j] = random_signal();
            if (least_dlc(&signals[4 * i + j].field) > group->least_dlc)
                group->least_dlc = least_dlc(&signals[4 * i + j].field);
        }
        pages[i].full_dlc = group->least_dlc;
    }
    pgn = (canser_pgn){0xea00, 12};
    database.ids = ids;
    database.id_cap = MESSAGES;
    database.id_count = MESSAGES;
    database.id_most = random_below(4) ? 4000 : 9;
    database.pgns = &pgn;
    database.pgn_count = 1;
    database.spread = (uint32_t)random_word() | 1;
    database.pages = pages;
    database.page_count = GROUPS;
    database.dlcs = dlcs;
    database.cursors = cursors;
    database.muxes = muxes;
    database.cases = cases;
    database.links = links;
    database.tables = tables;
    database.groups = groups;
    database.group_count = GROUPS;
    database.signals = signals;
    memset(places, 0, sizeof places);
    check(canser_database_move_ids(&database, places, 16) == CANSER_OK, "move");
}

static void make_frames(void)
{
    for (size_t i = 0; i < frame_count; i++) {
        canser_frame *const frame = &frames[i];
        const uint64_t data =
            random_below(3) ? random_word() : random_below(200) << random_below(57);

        memset(frame, 0, sizeof *frame);
        frame->ext = random_below(2) != 0;
        frame->id = (uint32_t)random_below(3);
        if (frame->ext && random_below(3) == 0)
            frame->id = 0x00ea0000 | (uint32_t)(random_word() & 0x1c00ffff);
        if (random_below(9) == 0)
            frame->id = (uint32_t)(random_word() & (frame->ext ? 0x1fffffff : 0x7ff));
        if (random_below(99) == 0)
            frame->id |= (uint32_t)1 << (29 + random_below(3));
        frame->rtr = random_below(20) == 0;
        frame->err = random_below(20) == 0;
        frame->dlc = (uint8_t)(random_below(3) ? 8 : random_below(16));
        memcpy(frame->data, &data, sizeof data);
        frame->ts = (int64_t)random_word();
    }
}

/* The message of a frame, or MESSAGES. */
static uint32_t plain_message(const canser_frame *frame)
{
    if (frame->id > 0x1fffffff)
        return MESSAGES;
    for (uint32_t i = 0; i < MESSAGES; i++)
        if (ids[i].key == (frame->id | (uint32_t)frame->ext << 31))
            return i;
    return frame->ext && (frame->id >> 16 & 0x3ff) == 0xea ? 4 : MESSAGES;
}

/* The bits of a field, one by one. */
static uint64_t plain_bits(const canser_field *field, const uint8_t *data)
{
    uint64_t value = 0;

    for (unsigned i = field->bit_count; i-- > 0;) {
        const unsigned place = field->shift + i;
        const uint8_t byte = field->is_big ? data[7 - place / 8] : data[place / 8];

        value = value << 1 | (byte >> place % 8 & 1);
    }
    if (field->is_signed)
        for (unsigned i = field->bit_count; i < 64; i++)
            value |= (value >> (field->bit_count - 1) & 1) << i;
    return value;
}

static double plain_half(uint64_t bits)
{
    double value = (double)(bits & 0x3ff) / 1024 + ((bits >> 10 & 31) != 0);
    int exponent = (int)(bits >> 10 & 31);

    for (exponent = (exponent ? exponent : 1) - 15; exponent > 0; exponent--)
        value *= 2;
    for (; exponent < 0; exponent++)
        value /= 2;
    if ((bits >> 10 & 31) == 31)
        value = bits & 0x3ff ? (double)DBL_MAX - DBL_MAX : DBL_MAX * 2;
    return bits >> 15 & 1 ? -value : value;
}

static bool is_not_a_number(uint64_t bits)
{
    return (bits & UINT64_C(0x7fffffffffffffff)) > UINT64_C(0x7ff0000000000000);
}

/* Whether an element of a column is what the bits tell; any NaN is one. */
static bool is_right(const canser_signal *signal, const uint8_t *data, uint64_t found)
{
    const uint64_t bits = plain_bits(&signal->field, data);
    uint64_t wanted = bits;
    double value = 0;
    uint32_t low = (uint32_t)bits;
    float narrow;

    if (signal->kind == CANSER_SIGNAL_WHOLE) {
        if (!signal->is_raw)
            wanted = bits * (uint64_t)signal->scale + (uint64_t)signal->offset;
        return wanted == found;
    }
    if (signal->kind == CANSER_SIGNAL_SCALED) {
        value = signal->field.is_signed ? (double)(int64_t)bits : (double)bits;
    } else if (signal->kind == CANSER_SIGNAL_FLOAT64) {
        memcpy(&value, &bits, sizeof value);
    } else if (signal->kind == CANSER_SIGNAL_FLOAT32) {
        memcpy(&narrow, &low, sizeof narrow);
        value = (double)narrow;
    } else if ((bits >> 10 & 31) == 31 && bits & 0x3ff) {
        return is_not_a_number(found);
    } else {
        value = plain_half(bits & 0xffff);
    }
    if (signal->kind == CANSER_SIGNAL_SCALED || !signal->is_raw)
        if (signal->kind == CANSER_SIGNAL_SCALED || signal->factor != 1 || signal->addend != 0) {
            const double scaled = value * signal->factor;

            value = scaled + signal->addend;
        }
    memcpy(&wanted, &value, sizeof wanted);
    return wanted == found || (is_not_a_number(wanted) && is_not_a_number(found));
}

/* Count the frames; with more places for ids each time that they are used up. */
static void count_frames(void)
{
    static canser_known_id larger[16384];
    size_t done = 0, used;

    while (done < frame_count) {
        check(canser_database_count(&database, frames + done, frame_count - done, routes + done,
                                    &used) == CANSER_OK,
              "count");
        done += used;
        if (done < frame_count) {
            canser_known_id *const next = database.ids == places ? larger : places;

            memset(next, 0, sizeof places);
            check(canser_database_move_ids(&database, next, 2 * database.id_cap) == CANSER_OK,
                  "move");
        }
    }
}

/* Whether a frame has a page: `number` is that of the page among those of its message. */
static bool has_page(const canser_frame *frame, uint32_t message, uint32_t number, uint32_t dlc)
{
    const canser_mux *const mux = &muxes[message];
    uint64_t value;

    if (number == 0)
        return true;
    if (message < 2 || dlc < mux->least_dlc)
        return false;
    value = plain_bits(&mux->field, frame->data);
    for (uint32_t i = 0; i < CASES; i++) {
        const canser_case *const each = &cases[CASES * message + i];

        if (value < each->low || value > each->high)
            continue;
        for (uint32_t link = 0; link < each->link_count; link++)
            if (links[each->first_link + link] == 3 * message + number)
                return true;
    }
    return false;
}

/* Look for each frame's samples in the columns, in order. */
static void check_columns(void)
{
    size_t at[GROUPS] = {0};
    uint64_t remote = 0, errors = 0, others = 0, found = database.other_count;

    for (size_t i = 0; i < database.id_cap; i++)
        found += database.ids[i].page == CANSER_NO_MESSAGE ? database.ids[i].count : 0;
    for (size_t i = 0; i < frame_count; i++) {
        const canser_frame *const frame = &frames[i];
        const uint32_t dlc = frame->dlc > 8 ? 8 : frame->dlc;
        const uint32_t message = plain_message(frame);

        errors += frame->err;
        remote += frame->rtr && !frame->err;
        others += !frame->rtr && !frame->err && message == MESSAGES;
        if (frame->rtr || frame->err || message == MESSAGES)
            continue;
        for (uint32_t page = 0; page < 3; page++) {
            canser_group *const group = &groups[3 * message + page];
            size_t *const place = &at[3 * message + page];

            if (!has_page(frame, message, page, dlc) || dlc < group->least_dlc)
                continue;
            check(*place < group->count && group->ts[*place] == frame->ts, "time");
            for (uint32_t j = 0; *place < group->count && j < group->signal_count; j++) {
                const canser_signal *const signal = &signals[group->first_signal + j];

                check(is_right(signal, frame->data, ((const uint64_t *)signal->values)[*place]),
                      "value");
            }
            ++*place;
        }
    }
    for (size_t i = 0; i < GROUPS; i++)
        check(at[i] == groups[i].count && groups[i].count == groups[i].cap, "samples");
    check(database.remote_count == remote && database.error_count == errors, "kinds");
    check(found == others, "frames without a message");
}

/* Give each group just the room that it needs, as was counted. */
static void make_columns(void)
{
    for (uint32_t i = 0; i < GROUPS; i++) {
        canser_group *const group = &groups[i];

        group->cap = 0;
        for (uint32_t dlc = group->least_dlc; dlc < 9; dlc++)
            group->cap += dlcs[9 * i + dlc];
        group->ts = (int64_t *)(void *)guarded(8 * FRAMES) - group->cap;
        group->block = (uint64_t *)(void *)guarded(BLOCK_BYTES) - 2 * CANSER_SIGNAL_BLOCK;
        for (uint32_t j = 0; j < group->signal_count; j++)
            signals[group->first_signal + j].values =
                (uint64_t *)(void *)guarded(8 * FRAMES) - group->cap;
    }
}

/* Often have a group with much room, which no frame is for: then columns are stored past the cache.
 */
static void make_large(void)
{
    static uint64_t block[2 * CANSER_SIGNAL_BLOCK];
    static int64_t ts[1];

    database.group_count = GROUPS + random_below(2);
    groups[GROUPS] = (canser_group){.ts = ts, .cap = (size_t)1 << 30, .block = block};
}

static void free_columns(void)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    const size_t column = (8 * FRAMES + page - 1) / page * page;
    const size_t block = (BLOCK_BYTES + page - 1) / page * page;

    for (uint32_t i = 0; i < GROUPS; i++) {
        canser_group *const group = &groups[i];

        munmap((uint8_t *)(group->ts + group->cap) - column, column + page);
        munmap((uint8_t *)(group->block + 2 * CANSER_SIGNAL_BLOCK) - block, block + page);
        for (uint32_t j = 0; j < group->signal_count; j++) {
            uint64_t *const values = signals[group->first_signal + j].values;

            munmap((uint8_t *)(values + group->cap) - column, column + page);
        }
    }
}

static void check_errors(void)
{
    const canser_frame *const odd = (const canser_frame *)(const void *)((const char *)frames + 1);
    canser_database none;
    size_t used = 1;

    memset(&none, 0, sizeof none);
    check(canser_database_count(NULL, frames, 1, routes, &used) == CANSER_NULL && !used, "null");
    check(canser_database_count(&none, frames, 1, routes, &used) == CANSER_NULL, "no ids");
    check(canser_database_count(&database, NULL, 1, routes, &used) == CANSER_NULL, "no frames");
    check(canser_database_count(&database, frames, 1, NULL, &used) == CANSER_NULL, "no routes");
    check(canser_database_count(&database, frames, 1, routes, NULL) == CANSER_NULL, "no used");
    check(canser_database_count(&database, NULL, 0, NULL, &used) == CANSER_OK, "none");
    check(canser_database_count(&database, odd, 1, routes, &used) == CANSER_MISALIGNED, "odd");
    check(canser_database_decode(NULL, frames, 1, routes) == CANSER_NULL, "null");
    check(canser_database_decode(&database, odd, 1, routes) == CANSER_MISALIGNED, "odd");
    check(canser_database_move_ids(&database, NULL, 16) == CANSER_NULL, "nowhere");
    check(canser_database_move_ids(&database, places, 48) == CANSER_RANGE, "no power of two");
    check(canser_database_move_ids(&database, places, 4) == CANSER_RANGE, "too few");
}

/* A group without room for all of its frames keeps what it has, and touches nothing behind. */
static void check_no_room(void)
{
    const uint32_t number = (uint32_t)random_below(GROUPS);
    canser_group *const group = &groups[number];
    const size_t room = group->cap;

    for (size_t i = 0; i < GROUPS; i++)
        groups[i].count = 0;
    if (!room)
        return;
    group->cap--;
    group->ts++;
    for (uint32_t j = 0; j < group->signal_count; j++)
        signals[group->first_signal + j].values =
            (uint64_t *)signals[group->first_signal + j].values + 1;
    check(canser_database_decode(&database, frames, frame_count, routes) == CANSER_RANGE, "room");
    check(group->count == group->cap, "full");
}

/* All values of 16 bits by 0.1 and -40.05, as numpy has them: with two roundings each. One
 * rounding, by an instruction that multiplies and adds, gives others for a third of them. The sum
 * of all was made by numpy: sum = sum * 31 + bits. */
static void check_roundings(void)
{
    static canser_frame all[65536];
    static uint16_t all_routes[65536];
    static double values[65536];
    static int64_t ts[65536];
    static uint64_t block[2 * CANSER_SIGNAL_BLOCK];
    static canser_cursor *cursor;
    static canser_known_id place[64];
    canser_known_id id = {.key = 0x123, .page = 1};
    uint64_t counts[9] = {0};
    canser_page page = {.group_count = 1};
    canser_signal signal = {.factor = 0.1, .addend = -40.05, .values = values};
    canser_group group = {.ts = ts, .cap = 65536, .block = block, .signal_count = 1};
    canser_database one = {.ids = &id, .id_cap = 1, .id_count = 1, .id_most = 32, .spread = 1};
    uint64_t sum = 0;
    size_t used;

    signal.field = (canser_field){0, 0, 16, 0};
    signal.kind = CANSER_SIGNAL_SCALED;
    one.pages = &page;
    one.page_count = 1;
    one.dlcs = counts;
    one.cursors = &cursor;
    one.groups = &group;
    one.group_count = 1;
    one.signals = &signal;
    for (size_t i = 0; i < 65536; i++) {
        all[i].id = 0x123;
        all[i].dlc = 8;
        all[i].data[0] = (uint8_t)i;
        all[i].data[1] = (uint8_t)(i >> 8);
    }
    check(canser_database_move_ids(&one, place, 64) == CANSER_OK, "move one");
    check(canser_database_count(&one, all, 65536, all_routes, &used) == CANSER_OK, "count all");
    check(canser_database_decode(&one, all, 65536, all_routes) == CANSER_OK, "decode all");
    for (size_t i = 0; i < 65536; i++) {
        uint64_t bits;

        memcpy(&bits, &values[i], sizeof bits);
        sum = sum * 31 + bits;
    }
    check(sum == UINT64_C(0xf38bba464c848e93), "roundings");
}

static void run_round(size_t round)
{
    frame_count = 1 + random_below(random_below(9) ? 900 : FRAMES); /* more than a block */
    frames = (canser_frame *)(void *)guarded(FRAMES * sizeof *frames) - frame_count;
    routes = (uint16_t *)(void *)guarded(FRAMES * sizeof *routes) - frame_count;
    make_database();
    make_frames();
    if (!round) {
        check_errors();
        check_roundings();
    }
    count_frames();
    make_columns();
    make_large();
    check(canser_database_decode(&database, frames, frame_count, routes) == CANSER_OK, "decode");
    check_columns();
    check_no_room();
    free_columns();
}

int main(int argc, char **argv)
{
    const unsigned long rounds = argc > 1 ? strtoul(argv[1], NULL, 10) : 100;

    for (unsigned long i = 0; i < rounds; i++)
        run_round(i);
    return told();
}
