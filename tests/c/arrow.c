/* What canser.h promises of tables: columns are what a plain loop makes of the frames, no memory
 * but the caller's is read, what is exported may be released in any order and from any thread, all
 * memory is given back, and none is lost where there is no more. Every array lies against a page
 * that may not be touched. POSIX only. It is built with -DCANSER_MALLOC=counted_malloc
 * -DCANSER_FREE=counted_free. */
#define _DEFAULT_SOURCE /* MAP_ANONYMOUS, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include "arrow.h"
#include "canser.h"

#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

enum { FRAMES_MAX = 600, COLUMNS = 9, THREADS = 4, TURNS = 200 };

static atomic_ullong passed, failed;

static void check(bool holds, const char *what, size_t round)
{
    if (holds)
        passed++;
    else if (failed++ < 10)
        printf("FAILED %s, round %zu\n", what, round);
}

/* Random numbers, the same in every run: xorshift64*. */
static uint64_t random_state = 0x9E3779B97F4A7C15;

static size_t random_below(size_t bound)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (size_t)((random_state * 0x2545F4914F6CDD1D >> 16) % bound);
}

/* Memory that is counted; the call of number `fails_at` gets none, counted from 0. */
static atomic_int blocks;
static int calls, fails_at = -1;
void *counted_malloc(size_t size);
void counted_free(void *p);

void *counted_malloc(size_t size)
{
    if (fails_at >= 0 && calls++ == fails_at)
        return NULL;
    /* Sanitizers end a program that asks for more than there is. */
    void *const p = size >> 32 ? NULL : malloc(size);
    if (p) {
        memset(p, 0xA5, size); /* so that nothing is zero by chance */
        blocks++;
    }
    return p;
}

void counted_free(void *p)
{
    blocks -= p != NULL;
    free(p);
}

static size_t page_size;

/* The end of room for `size` bytes behind which a page may not be touched. */
static uint8_t *guarded(size_t size)
{
    const size_t pages_size = (size + page_size - 1) / page_size * page_size;
    uint8_t *const p =
        mmap(NULL, pages_size + page_size, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    if (p == MAP_FAILED || mprotect(p, pages_size, PROT_READ | PROT_WRITE)) {
        perror("arrow: mmap");
        exit(2);
    }
    return p + pages_size;
}

static uint8_t *frames_end, *channels_end, *directions_end;

/* Frames of which some have no time, no channel, and flags and lengths that no decoder gives. */
static const canser_frame *make_frames(size_t count, uint8_t *channels, uint8_t *directions)
{
    canser_frame *const frames = (canser_frame *)(void *)frames_end - count;
    const size_t nulls = random_below(3); /* none, some, all */

    for (size_t i = 0; i < count; i++) {
        const bool is_null = nulls == 2 || (nulls && random_below(2));
        frames[i] = (canser_frame){
            .id = (uint32_t)random_below(UINT64_C(1) << 32),
            .ext = (uint8_t)random_below(3),
            .rtr = (uint8_t)random_below(3),
            .dlc = (uint8_t)random_below(256),
            .err = (uint8_t)random_below(3),
            .ts = is_null ? CANSER_NO_TIME : (int64_t)random_below(SIZE_MAX) - (1LL << 40),
        };
        for (size_t k = 0; k < 8; k++)
            frames[i].data[k] = (uint8_t)random_below(256);
        channels[i] = is_null ? CANSER_NO_CHANNEL : (uint8_t)random_below(256);
        directions[i] = (uint8_t)random_below(2);
    }
    return frames;
}

static canser_column column_of(const char *name, const char *format, const void *values,
                               ptrdiff_t stride, size_t size, int kind, int nulls)
{
    return (canser_column){.name = name,
                           .format = format,
                           .values = values,
                           .stride = stride,
                           .size = size,
                           .kind = kind,
                           .nulls = nulls};
}

/* Make a table of frames as the binding makes it. */
static int frames_table(const canser_frame *frames, const uint8_t *channels,
                        const uint8_t *directions, size_t count, int is_dated, canser_table **table)
{
    static const uint8_t untold = CANSER_NO_CHANNEL, not_sent = 0;
    static const canser_frame none;
    const canser_frame *const f = frames ? frames : &none;
    const ptrdiff_t stride = sizeof *f;
    const canser_column columns[COLUMNS] = {
        column_of("ts", is_dated ? "tsn:UTC" : "tDn", &f->ts, stride, 8, CANSER_COLUMN_VALUES,
                  CANSER_NULLS_NO_TIME),
        column_of("channel", "C", channels ? channels : &untold, channels != NULL, 1,
                  CANSER_COLUMN_VALUES, channels ? CANSER_NULLS_NO_CHANNEL : CANSER_NULLS_ALL),
        column_of("sent", "b", directions ? directions : &not_sent, directions != NULL, 1,
                  CANSER_COLUMN_FLAGS, directions ? CANSER_NULLS_NONE : CANSER_NULLS_ALL),
        column_of("id", "I", &f->id, stride, 4, CANSER_COLUMN_VALUES, CANSER_NULLS_NONE),
        column_of("ext", "b", &f->ext, stride, 1, CANSER_COLUMN_FLAGS, CANSER_NULLS_NONE),
        column_of("rtr", "b", &f->rtr, stride, 1, CANSER_COLUMN_FLAGS, CANSER_NULLS_NONE),
        column_of("err", "b", &f->err, stride, 1, CANSER_COLUMN_FLAGS, CANSER_NULLS_NONE),
        column_of("dlc", "C", &f->dlc, stride, 1, CANSER_COLUMN_VALUES, CANSER_NULLS_NONE),
        column_of("data", "w:8", f->data, stride, 8, CANSER_COLUMN_VALUES, CANSER_NULLS_NONE),
    };

    return canser_table_new(columns, COLUMNS, count, table);
}

static bool bit(const uint8_t *bits, size_t i)
{
    return bits[i / 8] >> i % 8 & 1;
}

/* Whether all bytes from `used` up to the next multiple of 64 are zero. */
static bool is_padded(const uint8_t *p, size_t used)
{
    while (used % 64)
        if (p[used++])
            return false;
    return true;
}

static void compare(const struct ArrowArray *array, const canser_frame *frames,
                    const uint8_t *channels, const uint8_t *directions, size_t count)
{
    static const size_t bits_of[COLUMNS] = {64, 8, 1, 32, 1, 1, 1, 8, 64};
    int64_t nulls[COLUMNS] = {0};
    bool same = true, valid_right = true;

    check(array->length == (int64_t)count && !array->null_count && !array->offset &&
              array->n_buffers == 1 && array->n_children == COLUMNS && !array->buffers[0] &&
              !array->dictionary,
          "struct array", count);
    for (int column = 0; column < COLUMNS; column++) {
        const struct ArrowArray *const child = array->children[column];
        const uint8_t *const valid = child->buffers[0], *const p = child->buffers[1];
        const size_t used = (count * bits_of[column] + 7) / 8;

        check(child->length == (int64_t)count && !child->offset && child->n_buffers == 2 &&
                  !child->n_children && !child->dictionary && child->release != NULL,
              "child", count);
        check(p && (uintptr_t)p % 64 == 0 && is_padded(p, used), "a column's padding", count);
        check(!valid || ((uintptr_t)valid % 64 == 0 && is_padded(valid, (count + 7) / 8)),
              "padding of valid bits", count);
        for (size_t i = 0; i < count; i++) {
            const canser_frame *const frame = frames + i;
            const bool flags[COLUMNS] = {[2] = directions && directions[i] == CANSER_SENT,
                                         [4] = frame->ext != 0,
                                         [5] = frame->rtr != 0,
                                         [6] = frame->err != 0};
            const bool known[COLUMNS] = {frame->ts != CANSER_NO_TIME,
                                         channels && channels[i] != CANSER_NO_CHANNEL,
                                         directions != NULL,
                                         true,
                                         true,
                                         true,
                                         true,
                                         true,
                                         true};
            const uint8_t channel = channels ? channels[i] : CANSER_NO_CHANNEL;

            nulls[column] += !known[column];
            valid_right &= (!valid || bit(valid, i)) == known[column];
            switch (column) {
            case 0:
                same &= !memcmp(p + 8 * i, &frame->ts, 8);
                break;
            case 1:
                same &= p[i] == channel;
                break;
            case 3:
                same &= !memcmp(p + 4 * i, &frame->id, 4);
                break;
            case 7:
                same &= p[i] == frame->dlc;
                break;
            case 8:
                same &= !memcmp(p + 8 * i, frame->data, 8);
                break;
            default:
                same &= bit(p, i) == flags[column];
            }
        }
        check(child->null_count == nulls[column], "a count of nulls", count);
    }
    check(same, "values", count);
    check(valid_right, "valid bits", count);
}

static void compare_schema(const struct ArrowSchema *schema, bool is_dated)
{
    static const char *const names[COLUMNS] = {"ts",  "channel", "sent", "id",  "ext",
                                               "rtr", "err",     "dlc",  "data"};
    const char *const formats[COLUMNS] = {
        is_dated ? "tsn:UTC" : "tDn", "C", "b", "I", "b", "b", "b", "C", "w:8"};
    bool same = !strcmp(schema->format, "+s") && schema->n_children == COLUMNS &&
                !schema->metadata && !schema->dictionary;

    for (int i = 0; same && i < COLUMNS; i++) {
        const struct ArrowSchema *const child = schema->children[i];
        same = !strcmp(child->format, formats[i]) && !strcmp(child->name, names[i]) &&
               child->flags == ARROW_FLAG_NULLABLE && !child->n_children && !child->metadata;
    }
    check(same, "schema", (size_t)is_dated);
}

/* A struct that is moved away, as consumers move it. Some of them leave nothing behind. */
static struct ArrowArray move_array(struct ArrowArray *from)
{
    const struct ArrowArray moved = *from;

    if (random_below(2))
        *from = (struct ArrowArray){.release = NULL};
    from->release = NULL;
    return moved;
}

/* Export all there is, move some of it, and release everything in any order. */
static void export_and_release(canser_table *table, const canser_frame *frames,
                               const uint8_t *channels, const uint8_t *directions, size_t count,
                               bool is_dated)
{
    enum { TABLE, SCHEMA, ARRAY, STREAM, MOVED, FROM_STREAM, SCHEMA_MOVED, FIRST_CHILD };
    struct ArrowSchema *schema, schema_moved, child_schema = {.release = NULL};
    struct ArrowArray *array, moved, from_stream, children[COLUMNS];
    struct ArrowArrayStream *stream;
    size_t order[FIRST_CHILD + COLUMNS];
    const size_t steps = sizeof order / sizeof *order;

    check(!canser_table_schema(table, &schema), "schema", count);
    check(!canser_table_array(table, &array), "array", count);
    check(!canser_table_stream(table, &stream), "stream", count);
    compare_schema(schema, is_dated);
    compare(array, frames, channels, directions, count);
    check(!stream->get_schema(stream, &schema_moved), "the stream's schema", count);
    compare_schema(&schema_moved, is_dated);
    check(!stream->get_next(stream, &from_stream) && from_stream.release, "a batch", count);
    compare(&from_stream, frames, channels, directions, count);
    check(!stream->get_next(stream, &moved) && !moved.release, "the end of a stream", count);
    check(!stream->get_last_error(stream), "no error", count);

    moved = (struct ArrowArray){.release = NULL};
    if (random_below(2)) {
        moved = move_array(array);
        check(!array->release, "moved away", count);
    }
    struct ArrowArray *const parent = moved.release ? &moved : array;
    for (int i = 0; i < COLUMNS; i++) {
        children[i] = (struct ArrowArray){.release = NULL};
        if (random_below(2))
            children[i] = move_array(parent->children[i]);
    }
    if (random_below(2)) {
        child_schema = *schema->children[3];
        schema->children[3]->release = NULL;
    }

    for (size_t i = 0; i < steps; i++)
        order[i] = i;
    for (size_t i = steps - 1; i; i--) {
        const size_t k = random_below(i + 1), other = order[k];
        order[k] = order[i];
        order[i] = other;
    }
    for (size_t i = 0; i < steps; i++) {
        struct ArrowArray *left = NULL;
        switch (order[i]) {
        case TABLE:
            canser_table_release(table);
            break;
        case SCHEMA:
            canser_schema_free(schema);
            break;
        case ARRAY:
            canser_array_free(array);
            break;
        case STREAM:
            canser_array_stream_free(stream);
            break;
        case MOVED:
            left = &moved;
            break;
        case FROM_STREAM:
            compare(&from_stream, frames, channels, directions, count);
            left = &from_stream;
            break;
        case SCHEMA_MOVED:
            schema_moved.release(&schema_moved);
            check(!schema_moved.release, "a released schema", count);
            break;
        default:
            left = &children[order[i] - FIRST_CHILD];
        }
        if (left && left->release) {
            /* What it shows is still there, whatever was released before. */
            check(left->length == (int64_t)count, "a length", count);
            left->release(left);
            check(!left->release, "a released array", count);
        }
    }
    if (child_schema.release) {
        check(!strcmp(child_schema.name, "id"), "a child's schema", count);
        child_schema.release(&child_schema);
    }
    check(!blocks, "blocks of memory are left", count);
}

static void one_round(size_t round)
{
    const size_t count = round < 130 ? round : random_below(FRAMES_MAX + 1);
    uint8_t *const channels = channels_end - count, *const directions = directions_end - count;
    const canser_frame *const frames = make_frames(count, channels, directions);
    const uint8_t *const told = random_below(3) ? channels : NULL, *const ways = random_below(3)
                                                                                     ? directions
                                                                                     : NULL;
    const bool is_dated = random_below(2);
    canser_table *table;

    check(!frames_table(frames, told, ways, count, is_dated, &table), "new", round);
    export_and_release(table, frames, told, ways, count, is_dated);
}

/* Texts, lists, numbers of which some are none; from records that lie backwards. */
static void other_columns(size_t round)
{
    typedef struct {
        char text[5];
        uint8_t bytes[3];
        double number;
    } record;
    const size_t count = 1 + random_below(40);
    record *const records = (record *)(void *)guarded(count * sizeof *records) - count;
    const record *const last = records + count - 1;
    const ptrdiff_t back = -(ptrdiff_t)sizeof *last;
    canser_table *table;
    struct ArrowSchema *schema;
    struct ArrowArray *array;
    const uint8_t *values, *valid;
    bool same = true;
    int64_t nulls = 0;

    for (size_t i = 0; i < count; i++) {
        const size_t len = random_below(6);
        memset(&records[i], 0, sizeof *records);
        memset(records[i].text, 'a' + (int)(i % 26), len);
        records[i].bytes[i % 3] = (uint8_t)i;
        records[i].number = random_below(3) ? (double)i : (double)NAN;
    }
    const canser_column columns[] = {
        column_of("text", "U", last->text, back, 5, CANSER_COLUMN_TEXT, CANSER_NULLS_NONE),
        column_of("bytes", "+w:3", last->bytes, back, 3, CANSER_COLUMN_LIST, CANSER_NULLS_NONE),
        column_of("number", "g", &last->number, back, 8, CANSER_COLUMN_VALUES, CANSER_NULLS_NAN),
    };
    check(!canser_table_new(columns, 3, count, &table), "new", round);
    check(!canser_table_schema(table, &schema), "schema", round);
    check(!canser_table_array(table, &array), "array", round);
    check(!strcmp(schema->children[1]->children[0]->format, "C"), "a list's schema", round);
    const struct ArrowArray *const text = array->children[0], *const list = array->children[1];
    const int64_t *const ends = text->buffers[1];
    const struct ArrowArray *const items = list->children[0];
    check(text->n_buffers == 3 && list->n_buffers == 1 && list->n_children == 1 &&
              items->length == (int64_t)(3 * count) && !ends[0],
          "a text and a list", round);
    for (size_t i = 0; i < count; i++) {
        const record *const from = last - i;
        const size_t len = strnlen(from->text, 5);
        const double *const number = array->children[2]->buffers[1];
        const uint8_t *const known = array->children[2]->buffers[0];
        same &= ends[i + 1] - ends[i] == (int64_t)len &&
                !memcmp((const char *)text->buffers[2] + ends[i], from->text, len);
        same &= !memcmp((const uint8_t *)items->buffers[1] + 3 * i, from->bytes, 3);
        same &= !memcmp(&number[i], &from->number, sizeof *number);
        nulls += from->number != from->number;
        same &= (!known || bit(known, i)) == (from->number == from->number);
    }
    check(same && nulls == array->children[2]->null_count, "values of other columns", round);
    check(!canser_table_column(table, 2, &values, &valid) &&
              values == array->children[2]->buffers[1] && valid == array->children[2]->buffers[0],
          "a view", round);
    check(canser_table_column(table, 3, &values, &valid) == CANSER_RANGE && !values, "no column",
          round);
    /* The one that owns the table last frees it. */
    canser_table_share(table);
    canser_table_release(table);
    canser_schema_free(schema);
    canser_array_free(array);
    canser_table_release(table);
    check(!blocks, "blocks of memory are left", round);
}

/* A number of 32 bits of metadata. */
static int32_t number_at(const char *p)
{
    int32_t number;

    memcpy(&number, p, sizeof number);
    return number;
}

/* Values that stay in a block, with metadata, and indices of texts, copied or in a block: all that
 * was made is released in any order. */
static void shared_columns(size_t round)
{
    enum { BLOCK, INDEX_BLOCK, TABLE, SCHEMA, ARRAY, STREAM, VALUES, INDICES, TEXTS, STEPS };
    static const char pair[] = "\1\0\0\0\1\0\0\0k\3\0\0\0rpm", words[] = "OffOnReverse";
    static const int32_t word_ends[] = {0, 3, 5, 5, 12};
    const size_t room = random_below(600), first = room ? random_below(room) : 0;
    const size_t count = room ? random_below(room - first + 1) : 0;
    uint8_t *const mask = guarded(count) - count;
    char *const metadata = (char *)guarded(sizeof pair - 1) - (sizeof pair - 1);
    char *const bytes = (char *)guarded(sizeof words - 1) - (sizeof words - 1);
    int32_t *const ends = (int32_t *)(void *)guarded(sizeof word_ends) - 5;
    const bool is_masked = random_below(2), is_shared = random_below(2);
    canser_block *block, *index_block;
    canser_table *table;
    struct ArrowSchema *schema;
    struct ArrowArray *array, parts[3], from_stream;
    struct ArrowArrayStream *stream;
    int64_t null_count = 0;
    bool same = true;
    size_t order[STEPS];

    check(!canser_block_new(room * sizeof(double), &block), "a block", round);
    check(!canser_block_new(room * sizeof(int32_t), &index_block), "a block", round);
    double *const numbers = (double *)(void *)canser_block_values(block);
    int32_t *const indices = (int32_t *)(void *)canser_block_values(index_block);
    check((uintptr_t)numbers % 64 == 0 && (uintptr_t)indices % 64 == 0 &&
              is_padded((uint8_t *)numbers, room * sizeof *numbers),
          "where a block begins and ends", round);
    memcpy(metadata, pair, sizeof pair - 1);
    memcpy(bytes, words, sizeof words - 1);
    memcpy(ends, word_ends, sizeof word_ends);
    for (size_t i = 0; i < room; i++) {
        numbers[i] = (double)i;
        indices[i] = (int32_t)(i % 4);
    }
    for (size_t i = 0; i < count; i++) {
        mask[i] = (uint8_t)(random_below(3) ? random_below(256) : 0);
        null_count += is_masked && !mask[i];
    }
    const canser_texts texts = {bytes, ends, 4};
    canser_column columns[] = {
        column_of("number", "g", numbers + first, 8, 8, CANSER_COLUMN_VALUES,
                  is_masked ? CANSER_NULLS_MASK : CANSER_NULLS_NONE),
        column_of("text", "i", indices + first, 4, 4, CANSER_COLUMN_DICTIONARY,
                  is_masked ? CANSER_NULLS_MASK : CANSER_NULLS_NONE),
    };
    columns[0].mask = columns[1].mask = mask;
    columns[0].metadata = metadata;
    columns[0].metadata_len = sizeof pair - 1;
    columns[0].block = block;
    columns[1].texts = &texts;
    columns[1].block = is_shared ? index_block : NULL;
    check(!canser_table_new(columns, 2, count, &table), "new", round);
    check(canser_block_owners(block) == 2, "two owners", round);
    check(canser_block_owners(index_block) == (is_shared ? 2 : 1), "owners", round);
    /* What only the call reads may be gone now. */
    memset(mask, 0xA5, count);
    memset(metadata, 0xA5, sizeof pair - 1);
    memset(bytes, 0xA5, sizeof words - 1);
    memset(ends, 0xA5, sizeof word_ends);
    check(!canser_table_schema(table, &schema), "schema", round);
    check(!canser_table_array(table, &array), "array", round);
    check(!canser_table_stream(table, &stream), "stream", round);
    check(!stream->get_next(stream, &from_stream), "a batch", round);

    const struct ArrowSchema *const fields[] = {schema->children[0], schema->children[1]};
    check(!memcmp(fields[0]->metadata, pair, sizeof pair - 1) &&
              number_at(fields[0]->metadata) == 1 && !fields[0]->dictionary && !fields[1]->metadata,
          "metadata", round);
    check(!strcmp(fields[1]->format, "i") && fields[1]->dictionary &&
              !strcmp(fields[1]->dictionary->format, "u") && !fields[1]->n_children,
          "a dictionary's schema", round);
    const struct ArrowArray *const number = array->children[0], *const text = array->children[1];
    const struct ArrowArray *const dictionary = text->dictionary;
    check(number->buffers[1] == numbers + first && number->null_count == null_count &&
              from_stream.children[0]->buffers[1] == numbers + first,
          "values that are shared", round);
    check((text->buffers[1] == indices + first) == is_shared && text->null_count == null_count &&
              text->n_buffers == 2 && !text->n_children,
          "indices", round);
    check(dictionary->length == 4 && dictionary->n_buffers == 3 && !dictionary->buffers[0] &&
              !memcmp(dictionary->buffers[1], word_ends, sizeof word_ends) &&
              !memcmp(dictionary->buffers[2], words, sizeof words - 1),
          "texts", round);
    for (size_t i = 0; i < count; i++)
        same &= ((const int32_t *)text->buffers[1])[i] == (int32_t)((first + i) % 4);
    check(same, "values of indices", round);

    parts[0] = parts[1] = parts[2] = (struct ArrowArray){.release = NULL};
    if (random_below(2))
        parts[0] = move_array(array->children[0]);
    if (random_below(2))
        parts[2] = move_array(array->children[1]->dictionary);
    if (random_below(2))
        parts[1] = move_array(array->children[1]);
    for (size_t i = 0; i < STEPS; i++)
        order[i] = i;
    for (size_t i = STEPS - 1; i; i--) {
        const size_t k = random_below(i + 1), other = order[k];
        order[k] = order[i];
        order[i] = other;
    }
    for (size_t i = 0; i < STEPS; i++) {
        struct ArrowArray *left = NULL;
        switch (order[i]) {
        case BLOCK:
            canser_block_release(block);
            break;
        case INDEX_BLOCK:
            canser_block_release(index_block);
            break;
        case TABLE:
            canser_table_release(table);
            break;
        case SCHEMA:
            canser_schema_free(schema);
            break;
        case ARRAY:
            canser_array_free(array);
            break;
        case STREAM:
            canser_array_stream_free(stream);
            break;
        default:
            left = &parts[order[i] - VALUES];
        }
        if (left && left->release) {
            if (left == &parts[0] && count)
                check(((const double *)left->buffers[1])[count - 1] == (double)(first + count - 1),
                      "a value whose table may be gone", round);
            if (left == &parts[2])
                check(!memcmp(left->buffers[2], words, sizeof words - 1),
                      "texts whose table may be gone", round);
            left->release(left);
        }
    }
    check(!count || ((const double *)from_stream.children[0]->buffers[1])[0] == (double)first,
          "a value, the last of all", round);
    from_stream.release(&from_stream);
    check(!blocks, "blocks of memory are left", round);
}

/* What a block and a dictionary must not be. */
static void mistakes_of_sharing(void)
{
    static const int32_t ends[] = {0, 1}, wrong_ends[] = {0, -1};
    const canser_texts texts = {"a", ends, 1}, wrong_texts = {"a", wrong_ends, 1},
                       no_ends = {"a", NULL, 0}, no_bytes = {NULL, ends, 1},
                       too_many = {"a", ends, (size_t)INT32_MAX + 1};
    canser_block *block = (void *)&block;
    canser_table *table;

    check(canser_block_new(1, NULL) == CANSER_NULL, "no block", 0);
    for (size_t few = 0; few < 20; few++)
        check(canser_block_new(SIZE_MAX >> few, &block) == CANSER_NO_MEMORY && !block,
              "a block that is too large", few);
    fails_at = calls = 0;
    check(canser_block_new(1, &block) == CANSER_NO_MEMORY && !block, "no memory for a block", 0);
    fails_at = -1;
    check(!canser_block_values(NULL) && !canser_block_owners(NULL), "no block", 1);
    canser_block_share(NULL);
    canser_block_release(NULL);
    check(!canser_block_new(0, &block) && canser_block_values(block), "an empty block", 0);
    canser_block_release(block);

    check(!canser_block_new(80, &block), "a block", 0);
    uint8_t *const values = canser_block_values(block);
    for (size_t wrong = 0; wrong < 16; wrong++) {
        static const int statuses[] = {CANSER_RANGE, CANSER_RANGE, CANSER_RANGE, CANSER_RANGE,
                                       CANSER_RANGE, CANSER_RANGE, CANSER_NULL,  CANSER_NULL,
                                       CANSER_NULL,  CANSER_RANGE, CANSER_RANGE, CANSER_RANGE,
                                       CANSER_NULL,  CANSER_OK,    CANSER_OK,    CANSER_OK};
        canser_column column =
            column_of("a", "l", values, 8, 8, CANSER_COLUMN_VALUES, CANSER_NULLS_NONE);
        size_t count = 10;
        column.block = block;
        if (wrong >= 6 && wrong <= 11) {
            column = column_of("a", "i", values, 4, 4, CANSER_COLUMN_DICTIONARY, CANSER_NULLS_NONE);
            column.texts = &texts;
        }
        switch (wrong) {
        case 0: /* one value behind the end */
            count = 11;
            break;
        case 1:
            column.values = values + 1;
            break;
        case 2:
            column.values = values - 8;
            break;
        case 3:
            column.stride = 16;
            break;
        case 4:
            column.kind = CANSER_COLUMN_FLAGS;
            break;
        case 5:
            column.kind = CANSER_COLUMN_TEXT;
            break;
        case 6:
            column.texts = NULL;
            break;
        case 7:
            column.texts = &no_ends;
            break;
        case 8:
            column.texts = &no_bytes;
            break;
        case 9:
            column.texts = &wrong_texts;
            break;
        case 10:
            column.texts = &too_many;
            break;
        case 11:
            column.size = 8;
            break;
        case 12:
            column.nulls = CANSER_NULLS_MASK;
            break;
        case 13: /* nothing behind the end */
            column.values = values + 80;
            count = 0;
            break;
        case 14:
            column.values = values + 72;
            column.stride = 0;
            count = 1;
            break;
        default:
            break;
        }
        check(canser_table_new(&column, 1, count, &table) == statuses[wrong] &&
                  !table == (statuses[wrong] != CANSER_OK),
              "a column of a block", wrong);
        canser_table_release(table);
        check(canser_block_owners(block) == 1, "one owner", wrong);
    }
    canser_block_release(block);
    check(!blocks, "blocks of memory are left", 2);
}

/* Wherever memory ends, the call says so, and what was there before is given back. */
static void without_memory(void)
{
    static const canser_frame frames[10];
    canser_table *table;
    struct ArrowSchema *schema, moved_schema;
    struct ArrowArray *array, moved;
    struct ArrowArrayStream *stream;

    fails_at = calls = 0;
    check(frames_table(frames, NULL, NULL, 10, 0, &table) == CANSER_NO_MEMORY && !table, "new", 0);
    fails_at = -1;
    check(!frames_table(frames, NULL, NULL, 10, 0, &table), "new", 1);
    fails_at = calls = 0;
    check(canser_table_schema(table, &schema) == CANSER_NO_MEMORY && !schema, "schema", 0);
    calls = 0;
    check(canser_table_array(table, &array) == CANSER_NO_MEMORY && !array, "array", 0);
    calls = 0;
    check(canser_table_stream(table, &stream) == CANSER_NO_MEMORY && !stream, "stream", 0);
    fails_at = -1;
    check(!canser_table_stream(table, &stream), "stream", 1);
    fails_at = calls = 0;
    check(stream->get_schema(stream, &moved_schema) == ENOMEM, "the stream's schema", 0);
    check(stream->get_last_error(stream) != NULL, "an error", 0);
    calls = 0;
    check(stream->get_next(stream, &moved) == ENOMEM, "the stream's batch", 0);
    check(stream->get_last_error(stream) != NULL, "an error", 1);
    fails_at = -1;
    check(!stream->get_next(stream, &moved) && moved.length == 10, "the batch after all", 0);
    check(!stream->get_last_error(stream), "no error any more", 0);
    moved.release(&moved);
    canser_array_stream_free(stream);
    canser_table_release(table);
    check(!blocks, "blocks of memory are left", 0);
}

static void mistakes(void)
{
    static const canser_frame frames[2];
    canser_table *table = (void *)&table;
    struct ArrowSchema *schema;
    struct ArrowArray *array;
    struct ArrowArrayStream *stream;

    check(frames_table(frames, NULL, NULL, 1, 0, NULL) == CANSER_NULL, "no table", 0);
    check(canser_table_new(NULL, 1, 1, &table) == CANSER_NULL && !table, "no columns", 0);
    for (int wrong = 0; wrong < 7; wrong++) {
        canser_column column =
            column_of("a", "C", frames, 1, 1, CANSER_COLUMN_VALUES, CANSER_NULLS_NONE);
        static const int statuses[] = {CANSER_NULL,  CANSER_NULL,  CANSER_NULL, CANSER_RANGE,
                                       CANSER_RANGE, CANSER_RANGE, CANSER_RANGE};
        column.name = wrong == 0 ? NULL : column.name;
        column.format = wrong == 1 ? NULL : column.format;
        column.values = wrong == 2 ? NULL : column.values;
        column.size = wrong == 3 ? 0 : column.size;
        column.kind = wrong == 4 ? CANSER_COLUMN_DICTIONARY + 1 : column.kind;
        column.nulls = wrong == 5 ? CANSER_NULLS_MASK + 1 : column.nulls;
        column.nulls = wrong == 6 ? CANSER_NULLS_NO_TIME : column.nulls;
        check(canser_table_new(&column, 1, 1, &table) == statuses[wrong] && !table, "a column",
              (size_t)wrong);
    }
    for (size_t few = 0; few < 30; few++)
        check(frames_table(frames, NULL, NULL, SIZE_MAX >> few, 0, &table) == CANSER_NO_MEMORY &&
                  !table,
              "too many", few);
    check(canser_table_schema(NULL, &schema) == CANSER_NULL && !schema, "no table", 1);
    check(canser_table_array(NULL, &array) == CANSER_NULL && !array, "no table", 2);
    check(canser_table_stream(NULL, &stream) == CANSER_NULL && !stream, "no table", 3);
    check(!frames_table(NULL, NULL, NULL, 0, 0, &table), "no frames at all", 0);
    check(canser_table_schema(table, NULL) == CANSER_NULL, "no schema", 0);
    check(canser_table_array(table, NULL) == CANSER_NULL, "no array", 0);
    check(canser_table_stream(table, NULL) == CANSER_NULL, "no stream", 0);
    canser_table_release(table);
    canser_table_release(NULL);
    canser_schema_free(NULL);
    canser_array_free(NULL);
    canser_array_stream_free(NULL);
    check(!blocks, "blocks of memory are left", 1);
}

/* Threads that release parts of one array, and export and release the table they share. */
typedef struct {
    canser_table *table;
    canser_block *block;
    struct ArrowArray part;
    struct ArrowSchema part_schema;
} share;

static void *release_share(void *argument)
{
    share *const own = argument;
    struct ArrowArray *array;

    check(own->part.length == 3, "a part", 0);
    canser_block_share(own->block);
    check(canser_block_values(own->block)[0] == 7, "a value of a block in a thread", 0);
    canser_block_release(own->block);
    canser_block_release(own->block);
    own->part.release(&own->part);
    own->part_schema.release(&own->part_schema);
    check(!canser_table_array(own->table, &array), "array in a thread", 0);
    check(((const uint8_t *)array->children[7]->buffers[1])[2] == 8, "a value in a thread", 0);
    canser_array_free(array);
    return NULL;
}

static void in_threads(size_t round)
{
    const canser_frame frames[3] = {{.dlc = 1}, {.dlc = 2}, {.dlc = 8}};
    share shares[THREADS];
    pthread_t threads[THREADS];
    struct ArrowArray *array;
    struct ArrowSchema *schema;
    canser_table *table;
    canser_block *block;

    check(!canser_block_new(1, &block), "a block", round);
    canser_block_values(block)[0] = 7;
    check(!frames_table(frames, NULL, NULL, 3, 0, &table), "new", round);
    check(!canser_table_array(table, &array), "array", round);
    check(!canser_table_schema(table, &schema), "schema", round);
    for (int i = 0; i < THREADS; i++) {
        canser_block_share(block);
        shares[i] = (share){table, block, *array->children[i], *schema->children[i]};
        array->children[i]->release = NULL;
        schema->children[i]->release = NULL;
    }
    for (int i = 0; i < THREADS; i++) {
        if (pthread_create(&threads[i], NULL, release_share, &shares[i])) {
            perror("arrow: pthread_create");
            exit(2);
        }
    }
    canser_block_release(block);
    canser_array_free(array);
    canser_schema_free(schema);
    for (int i = 0; i < THREADS; i++)
        pthread_join(threads[i], NULL);
    canser_table_release(table);
    check(!blocks, "blocks of memory are left", round);
}

enum { LARGE = 5 << 20 };

/* Large memory that is released is used again by what is not much smaller; and given back if there
 * is no other. */
static void in_kept_memory(void)
{
    uint8_t *values;
    canser_block *block, *other;

    check(!canser_block_new(LARGE, &block) && blocks == 1, "a large block", 0);
    values = canser_block_values(block);
    canser_block_release(block);
    check(blocks == 1, "its memory is kept", 0);
    check(!canser_block_new(LARGE - 9999, &block) && blocks == 1, "its memory is used again", 0);
    check(canser_block_values(block) == values, "its memory is the same", 0);
    check(!canser_block_new(LARGE, &other) && blocks == 2, "another large block", 0);
    canser_block_release(other);
    check(!canser_block_new(2 * LARGE, &other) && blocks == 3, "a larger block", 0);
    canser_block_release(other);
    check(!canser_block_new(99, &other) && blocks == 4, "a small block", 0);
    canser_block_release(other);
    check(blocks == 3, "small memory is not kept", 0);
    canser_block_release(block);
    for (size_t i = 0; i < 20; i++) { /* larger ones, so that none fits the next */
        const size_t size = 2 * LARGE + i * 100000;

        check(!canser_block_new(size, &block) && !canser_block_new(size, &other), "larger", i);
        canser_block_release(block);
        canser_block_release(other);
        check(blocks <= 8, "few pieces are kept", i);
    }
    check(!canser_block_new(12 * LARGE, &block) && !canser_block_new(12 * LARGE, &other), "huge",
          0);
    canser_block_release(block);
    canser_block_release(other);
    check(blocks == 1, "not more than 96 MiB are kept", 0);
    calls = 0;
    fails_at = 0;
    check(!canser_block_new(20 * LARGE, &block) && blocks == 1, "all is given back first", 0);
    fails_at = -1;
    canser_block_release(block);
    check(!blocks, "blocks of memory are left", 0);
}

/* Threads that have large blocks, of which none is another's. */
static void *use_large(void *argument)
{
    const uint8_t own = *(const uint8_t *)argument;

    for (int i = 0; i < 200; i++) {
        canser_block *block;
        uint8_t *values;

        check(!canser_block_new(LARGE, &block), "a large block in a thread", 0);
        values = canser_block_values(block);
        values[0] = values[LARGE - 1] = own;
        for (int j = 1; j < 9; j++)
            values[j * 1000] = (uint8_t)(own + j);
        for (int j = 1; j < 9; j++)
            check(values[j * 1000] == (uint8_t)(own + j), "a value of a large block", 0);
        check(values[0] == own && values[LARGE - 1] == own, "the ends of a large block", 0);
        canser_block_release(block);
    }
    return NULL;
}

static void in_threads_with_kept_memory(void)
{
    uint8_t numbers[THREADS];
    pthread_t threads[THREADS];
    canser_block *block;

    for (int i = 0; i < THREADS; i++) {
        numbers[i] = (uint8_t)(16 * i);
        if (pthread_create(&threads[i], NULL, use_large, &numbers[i])) {
            perror("arrow: pthread_create");
            exit(2);
        }
    }
    for (int i = 0; i < THREADS; i++)
        pthread_join(threads[i], NULL);
    calls = 0;
    fails_at = 0;
    check(!canser_block_new(99, &block), "a block after the threads", 0);
    fails_at = -1;
    canser_block_release(block);
    check(!blocks, "blocks of memory are left", 0);
}

int main(int argc, char **argv)
{
    const size_t rounds = argc > 1 ? (size_t)strtoul(argv[1], NULL, 10) : 2000;

    page_size = (size_t)sysconf(_SC_PAGESIZE);
    frames_end = guarded(FRAMES_MAX * sizeof(canser_frame));
    channels_end = guarded(FRAMES_MAX);
    directions_end = guarded(FRAMES_MAX);
    mistakes();
    mistakes_of_sharing();
    without_memory();
    in_kept_memory();
    in_threads_with_kept_memory();
    for (size_t round = 0; round < rounds; round++)
        one_round(round);
    for (size_t round = 0; round < TURNS; round++)
        in_threads(round);
    for (size_t round = 0; round < TURNS; round++)
        other_columns(round);
    for (size_t round = 0; round < 2 * TURNS; round++)
        shared_columns(round);
    printf("%llu passed, %llu failed\n", (unsigned long long)passed, (unsigned long long)failed);
    return failed != 0;
}
