/* Tables: columns of Arrow, which other programs take without a copy.
 *
 * A column is copied from an array of records, of frames or others. Bits of a column, and those
 * that tell which values are not null, stand 8 to a byte, the first one lowest. Rows are copied
 * in groups, all columns of a group together, so that records are read from memory once. Values
 * that lie in a block of memory already are shared instead.
 *
 * The takers of a table, or of a block, own its memory together, and the last one gives it back. A
 * taker may move a struct away from where it was made, and release it anywhere, in any order. So
 * all structs of one export stand in one room, which is freed when the last of them is released.
 *
 * Source: arrow.apache.org, The Arrow C data interface, The Arrow C stream interface, Arrow
 * columnar format.
 */
#include "arrow.h"

#include "memory.h"
#include "protocol.h"

#include <errno.h>
#include <stdlib.h>

/* Columns begin at multiples of this, and are padded to it with zeros, as Arrow recommends. */
enum { ALIGNMENT = 64 };

/* Rows that are copied at a time, a multiple of 8: 24 KiB of frames, which the nearest cache holds.
 */
enum { GROUP_ROWS = 1024 };

/* The widest value, the most columns, and the most texts of a dictionary. */
enum { SIZE_MOST = 1 << 16, COLUMNS_MOST = 1 << 15, COUNT_MOST = INT32_MAX };

struct canser_block {
    uint32_t refs; /* the caller, and each column of a table */
    size_t size;
    uint8_t *values; /* behind this struct */
};

typedef struct {
    char *name;
    char *format;
    char *metadata; /* NULL: there is none */
    int kind;
    int64_t null_count;
    uint8_t *valid;        /* the bits of values that are not null; NULL: all are valid */
    const uint8_t *values; /* of a text its ends, i64 */
    canser_block *block;   /* has the values; NULL: the table has them */
    uint8_t *texts;        /* the bytes of all texts, also of a dictionary; NULL in other columns */
    uint8_t *ends;         /* of a dictionary, i32 */
    int64_t text_count;
} table_column;

struct canser_table {
    uint32_t refs; /* the caller, and each array, stream and view */
    size_t row_count;
    size_t column_count;
    table_column columns[]; /* their names, formats and values follow */
};

CANSER_INLINE size_t padded(size_t size)
{
    return (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

/* The first multiple of ALIGNMENT from `p` on. */
CANSER_INLINE uint8_t *aligned(void *p)
{
    return (uint8_t *)p + (ALIGNMENT - (uintptr_t)p % ALIGNMENT) % ALIGNMENT;
}

int canser_block_new(size_t size, canser_block **block)
{
    if (!block)
        return CANSER_NULL;
    *block = NULL;
    if (size > SIZE_MAX / 2)
        return CANSER_NO_MEMORY;
    canser_block *const self = canser_memory_get(sizeof *self + ALIGNMENT + padded(size));
    if (!self)
        return CANSER_NO_MEMORY;
    *self = (canser_block){.refs = 1, .size = size, .values = aligned(self + 1)};
    memset(self->values + size, 0, padded(size) - size);
    *block = self;
    return CANSER_OK;
}

uint8_t *canser_block_values(const canser_block *self)
{
    return self ? self->values : NULL;
}

void canser_block_share(canser_block *self)
{
    if (self)
        CANSER_ADD(&self->refs, 1);
}

size_t canser_block_owners(canser_block *self)
{
    return self ? CANSER_ADD(&self->refs, 0) : 0;
}

void canser_block_release(canser_block *self)
{
    if (self && !CANSER_ADD(&self->refs, -1))
        canser_memory_release(self);
}

CANSER_INLINE const uint8_t *value_at(const canser_column *from, size_t row)
{
    return (const uint8_t *)from->values + (ptrdiff_t)row * from->stride;
}

/* The bytes of a text, without those behind its end. */
CANSER_INLINE size_t text_len(const canser_column *from, size_t row)
{
    const uint8_t *const end = memchr(value_at(from, row), 0, from->size);

    return end ? (size_t)(end - value_at(from, row)) : from->size;
}

static size_t texts_len(const canser_column *from, size_t row_count)
{
    size_t sum = 0;

    for (size_t i = 0; from->kind == CANSER_COLUMN_TEXT && i < row_count; i++)
        sum += text_len(from, i);
    return sum;
}

static size_t values_len(const canser_column *from, size_t row_count)
{
    if (from->block)
        return 0;
    switch (from->kind) {
    case CANSER_COLUMN_FLAGS:
        return (row_count + 7) / 8;
    case CANSER_COLUMN_TEXT:
        return (row_count + 1) * sizeof(int64_t);
    default:
        return row_count * from->size;
    }
}

/* Take the next `size` bytes, padded, and zero the last ones, of which some are padding. With
 * `*at` NULL only `*sum` grows. */
static uint8_t *take(uint8_t **at, size_t *sum, size_t size)
{
    uint8_t *const taken = *at;

    size = padded(size);
    *sum += size;
    if (!taken)
        return NULL;
    if (size)
        memset(taken + size - ALIGNMENT, 0, ALIGNMENT);
    *at += size;
    return taken;
}

/* Take as many bytes, and copy them. */
static uint8_t *take_copy(uint8_t **at, size_t *sum, const void *from, size_t size)
{
    uint8_t *const taken = take(at, sum, size);

    if (taken && size)
        memcpy(taken, from, size);
    return taken;
}

static char *take_text(uint8_t **at, size_t *sum, const char *text)
{
    return (char *)take_copy(at, sum, text, strlen(text) + 1);
}

/* Where the last text ends. */
CANSER_INLINE size_t last_end(const canser_texts *texts)
{
    return (size_t)texts->ends[texts->count];
}

/* Place what belongs to the columns at `at`, and return its size; with `self` NULL only that. */
static size_t place(canser_table *self, uint8_t *at, const canser_column *columns,
                    size_t column_count, size_t row_count)
{
    size_t sum = 0;

    for (size_t i = 0; i < column_count; i++) {
        const canser_column *const from = &columns[i];
        table_column to = {.kind = from->kind};

        to.name = take_text(&at, &sum, from->name);
        to.format = take_text(&at, &sum, from->format);
        if (from->metadata)
            to.metadata = (char *)take_copy(&at, &sum, from->metadata, from->metadata_len);
        to.block = from->block;
        to.values = take(&at, &sum, values_len(from, row_count));
        if (to.block)
            to.values = from->values;
        if (from->kind == CANSER_COLUMN_TEXT)
            to.texts = take(&at, &sum, texts_len(from, row_count) + 1);
        if (from->kind == CANSER_COLUMN_DICTIONARY) {
            const canser_texts *const texts = from->texts;
            to.text_count = (int64_t)texts->count;
            to.ends = take_copy(&at, &sum, texts->ends, (texts->count + 1) * sizeof *texts->ends);
            to.texts = take(&at, &sum, last_end(texts) + 1);
            if (to.texts)
                memcpy(to.texts, texts->bytes, last_end(texts));
        }
        if (from->nulls != CANSER_NULLS_NONE)
            to.valid = take(&at, &sum, (row_count + 7) / 8);
        if (self)
            self->columns[i] = to;
    }
    return sum;
}

CANSER_INLINE void copy_values(uint8_t *to, const uint8_t *from, ptrdiff_t stride, size_t size,
                               size_t count)
{
    for (size_t i = 0; i < count; i++)
        memcpy(to + i * size, from + (ptrdiff_t)i * stride, size);
}

/* Copy up to GROUP_ROWS rows of values; the usual sizes are constants. */
static void copy(uint8_t *to, const canser_column *from, size_t first, size_t count)
{
    const uint8_t *const source = value_at(from, first);

    to += first * from->size;
    switch (from->size) {
    case 1:
        copy_values(to, source, from->stride, 1, count);
        break;
    case 4:
        copy_values(to, source, from->stride, 4, count);
        break;
    case 8:
        copy_values(to, source, from->stride, 8, count);
        break;
    default:
        copy_values(to, source, from->stride, from->size, count);
    }
}

CANSER_INLINE uint8_t flags_at(const canser_column *from, size_t row, size_t count)
{
    const uint8_t *const p = value_at(from, row);
    unsigned bits = 0;

    for (size_t k = 0; k < count; k++)
        bits |= (unsigned)(p[(ptrdiff_t)k * from->stride] != 0) << k;
    return (uint8_t)bits;
}

static void copy_flags(uint8_t *to, const canser_column *from, size_t first, size_t count)
{
    const canser_column column = *from; /* which no byte that is written is a part of */
    size_t i = first;

    for (; i + 8 <= first + count; i += 8)
        to[i / 8] = flags_at(&column, i, 8);
    if (i < first + count)
        to[i / 8] = flags_at(&column, i, first + count - i);
}

static void copy_texts(uint8_t *ends, uint8_t *texts, const canser_column *from, size_t first,
                       size_t count)
{
    for (size_t i = first; i < first + count; i++) {
        int64_t begin = 0, end;

        if (i)
            memcpy(&begin, ends + i * sizeof begin, sizeof begin);
        else
            memcpy(ends, &begin, sizeof begin);
        end = begin + (int64_t)text_len(from, i);
        memcpy(texts + begin, value_at(from, i), (size_t)(end - begin));
        memcpy(ends + (i + 1) * sizeof end, &end, sizeof end);
    }
}

CANSER_INLINE bool is_null(const canser_column *from, int nulls, size_t row)
{
    const uint8_t *const p = value_at(from, row);
    int64_t time;
    double number;

    switch (nulls) {
    case CANSER_NULLS_NO_TIME:
        memcpy(&time, p, sizeof time);
        return time == CANSER_NO_TIME;
    case CANSER_NULLS_NO_CHANNEL:
        return *p == CANSER_NO_CHANNEL;
    case CANSER_NULLS_NAN:
        memcpy(&number, p, sizeof number);
        return number != number;
    case CANSER_NULLS_MASK:
        return !from->mask[row];
    default:
        return true;
    }
}

/* Set the bits of up to 8 values that are not null; return how many are. */
CANSER_INLINE unsigned valid_at(uint8_t *to, const canser_column *from, int nulls, size_t row,
                                size_t count)
{
    unsigned bits = 0, null_count = 0;

    for (size_t k = 0; k < count; k++) {
        const unsigned null = is_null(from, nulls, row + k);
        bits |= (null ^ 1U) << k;
        null_count += null;
    }
    *to = (uint8_t)bits;
    return null_count;
}

CANSER_INLINE void find_nulls(table_column *to, const canser_column *from, int nulls, size_t first,
                              size_t count)
{
    const canser_column column = *from;
    uint8_t *const valid = to->valid;
    int64_t null_count = 0;
    size_t i = first;

    for (; i + 8 <= first + count; i += 8)
        null_count += valid_at(valid + i / 8, &column, nulls, i, 8);
    if (i < first + count)
        null_count += valid_at(valid + i / 8, &column, nulls, i, first + count - i);
    to->null_count += null_count;
}

static void copy_rows(uint8_t *to, uint8_t *texts, const canser_column *from, size_t first,
                      size_t count)
{
    if (from->kind == CANSER_COLUMN_FLAGS)
        copy_flags(to, from, first, count);
    else if (from->kind == CANSER_COLUMN_TEXT)
        copy_texts(to, texts, from, first, count);
    else
        copy(to, from, first, count);
}

static void fill(table_column *to, const canser_column *from, size_t first, size_t count)
{
    if (!from->block)
        copy_rows((uint8_t *)(uintptr_t)to->values, to->texts, from, first, count);
    switch (from->nulls) {
    case CANSER_NULLS_NONE:
        break;
    case CANSER_NULLS_NO_TIME:
        find_nulls(to, from, CANSER_NULLS_NO_TIME, first, count);
        break;
    case CANSER_NULLS_MASK:
        find_nulls(to, from, CANSER_NULLS_MASK, first, count);
        break;
    default:
        find_nulls(to, from, from->nulls, first, count);
    }
}

/* Whether the values lie in the block of a column, one behind the other, as Arrow has them. */
static bool is_in_block(const canser_column *column, size_t row_count)
{
    const uintptr_t values = (uintptr_t)column->values, begin = (uintptr_t)column->block->values;
    const size_t size = column->block->size;

    return (column->kind == CANSER_COLUMN_VALUES || column->kind == CANSER_COLUMN_DICTIONARY) &&
           (column->stride == (ptrdiff_t)column->size || row_count < 2) && values >= begin &&
           values - begin <= size && row_count <= (size - (values - begin)) / column->size;
}

static int check(const canser_column *columns, size_t column_count, size_t row_count)
{
    if (!columns && column_count)
        return CANSER_NULL;
    for (size_t i = 0; i < column_count; i++) {
        const canser_column *const column = &columns[i];
        if (!column->name || !column->format || (!column->values && row_count))
            return CANSER_NULL;
        if (column->nulls == CANSER_NULLS_MASK && !column->mask && row_count)
            return CANSER_NULL;
        if (column->kind < CANSER_COLUMN_VALUES || column->kind > CANSER_COLUMN_DICTIONARY ||
            column->nulls < CANSER_NULLS_NONE || column->nulls > CANSER_NULLS_MASK ||
            !column->size || column->size > SIZE_MOST)
            return CANSER_RANGE;
        if (column->kind == CANSER_COLUMN_DICTIONARY) {
            const canser_texts *const texts = column->texts;
            if (!texts || !texts->bytes || !texts->ends)
                return CANSER_NULL;
            if (column->size != sizeof(int32_t) || texts->count > COUNT_MOST ||
                texts->ends[texts->count] < 0)
                return CANSER_RANGE;
        }
        if (column->block && !is_in_block(column, row_count))
            return CANSER_RANGE;
        if (column->size < 8 &&
            (column->nulls == CANSER_NULLS_NO_TIME || column->nulls == CANSER_NULLS_NAN))
            return CANSER_RANGE;
    }
    return column_count > COLUMNS_MOST ? CANSER_RANGE : CANSER_OK;
}

/* Whether the size of all columns can be told: texts have ends of 8 bytes, too, and there may be
 * bits. */
static bool fits(const canser_column *columns, size_t column_count, size_t row_count)
{
    size_t row_size = 0;

    for (size_t i = 0; i < column_count; i++)
        row_size += columns[i].size + sizeof(int64_t) + 1;
    return !row_size || row_count < SIZE_MAX / 4 / row_size;
}

int canser_table_new(const canser_column *columns, size_t column_count, size_t row_count,
                     canser_table **table)
{
    int status;
    size_t size;

    if (!table)
        return CANSER_NULL;
    *table = NULL;
    status = check(columns, column_count, row_count);
    if (status)
        return status;
    if (!fits(columns, column_count, row_count))
        return CANSER_NO_MEMORY;
    size = sizeof(canser_table) + column_count * sizeof(table_column);
    canser_table *const self =
        canser_memory_get(size + ALIGNMENT + place(NULL, NULL, columns, column_count, row_count));
    if (!self)
        return CANSER_NO_MEMORY;
    *self = (canser_table){.refs = 1, .row_count = row_count, .column_count = column_count};
    place(self, aligned((uint8_t *)self + size), columns, column_count, row_count);
    for (size_t first = 0; first < row_count; first += GROUP_ROWS) {
        const size_t left = row_count - first, count = left < GROUP_ROWS ? left : GROUP_ROWS;
        for (size_t i = 0; i < column_count; i++)
            fill(&self->columns[i], &columns[i], first, count);
    }
    for (size_t i = 0; i < column_count; i++) {
        table_column *const column = &self->columns[i];
        if (!column->null_count)
            column->valid = NULL;
        canser_block_share(column->block);
    }
    *table = self;
    return CANSER_OK;
}

void canser_table_share(canser_table *self)
{
    if (self)
        CANSER_ADD(&self->refs, 1);
}

void canser_table_release(canser_table *self)
{
    if (!self || CANSER_ADD(&self->refs, -1))
        return;
    for (size_t i = 0; i < self->column_count; i++)
        canser_block_release(self->columns[i].block);
    canser_memory_release(self);
}

int canser_table_column(const canser_table *self, size_t index, const uint8_t **values,
                        const uint8_t **valid)
{
    if (!self || !values || !valid)
        return CANSER_NULL;
    *values = *valid = NULL;
    if (index >= self->column_count)
        return CANSER_RANGE;
    *values = self->columns[index].values;
    *valid = self->columns[index].valid;
    return CANSER_OK;
}

/* The children of a column, of which a list has one. */
CANSER_INLINE int64_t child_count(const table_column *column)
{
    return column->kind == CANSER_COLUMN_LIST;
}

/* The bytes of a list: its format is "+w:" and their number. */
static int64_t list_len(const table_column *column)
{
    return (int64_t)strtoul(column->format + 3, NULL, 10);
}

/* The room of a schema: it is freed when its maker has freed it, and the schema and all below it
 * are released. The struct that the maker gets is the first one, so the room begins
 * there. A struct that was moved away finds the room by its private data. */
typedef struct {
    struct ArrowSchema column, item;
    struct ArrowSchema *item_pointers[1];
} schema_slot;

typedef struct {
    struct ArrowSchema schema;
    uint32_t refs;
    canser_table *table; /* has the names and formats */
    schema_slot slots[]; /* one for each column; pointers to them follow */
} schema_room;

static void leave_schema_room(schema_room *room)
{
    if (!CANSER_ADD(&room->refs, -1)) {
        canser_table_release(room->table);
        canser_memory_release(room);
    }
}

static void release_schema(struct ArrowSchema *schema)
{
    for (int64_t i = 0; i < schema->n_children; i++) {
        struct ArrowSchema *const child = schema->children[i];
        if (child->release)
            child->release(child);
    }
    if (schema->dictionary && schema->dictionary->release)
        schema->dictionary->release(schema->dictionary);
    schema->release = NULL;
    leave_schema_room(schema->private_data);
}

int canser_table_schema(canser_table *self, struct ArrowSchema **schema)
{
    if (!schema)
        return CANSER_NULL;
    *schema = NULL;
    if (!self)
        return CANSER_NULL;
    const size_t count = self->column_count;
    schema_room *const room = canser_memory_get(
        sizeof *room + count * (sizeof *room->slots + sizeof(struct ArrowSchema *)));
    if (!room)
        return CANSER_NO_MEMORY;
    struct ArrowSchema **const pointers = (struct ArrowSchema **)(void *)&room->slots[count];
    *room = (schema_room){
        .schema = {.format = "+s",
                   .name = "",
                   .n_children = (int64_t)count,
                   .children = pointers,
                   .release = release_schema,
                   .private_data = room},
        .refs = 2,
        .table = self,
    };
    for (size_t i = 0; i < count; i++) {
        const table_column *const column = &self->columns[i];
        schema_slot *const slot = &room->slots[i];
        slot->item = (struct ArrowSchema){.format = column->ends ? "u" : "C",
                                          .name = column->ends ? "" : "item",
                                          .flags = column->ends ? ARROW_FLAG_NULLABLE : 0,
                                          .release = release_schema,
                                          .private_data = room};
        slot->item_pointers[0] = &slot->item;
        slot->column = (struct ArrowSchema){
            .format = column->format,
            .name = column->name,
            .metadata = column->metadata,
            .flags = ARROW_FLAG_NULLABLE,
            .n_children = child_count(column),
            .children = slot->item_pointers,
            .dictionary = column->ends ? &slot->item : NULL,
            .release = release_schema,
            .private_data = room,
        };
        room->refs += 1 + (uint32_t)child_count(column) + (column->ends != NULL);
        pointers[i] = &slot->column;
    }
    canser_table_share(self);
    *schema = &room->schema;
    return CANSER_OK;
}

void canser_schema_free(struct ArrowSchema *schema)
{
    if (!schema)
        return;
    if (schema->release)
        schema->release(schema);
    leave_schema_room((schema_room *)(void *)schema);
}

/* The room of an array, as that of a schema. It keeps the table. */
typedef struct {
    struct ArrowArray column, item;
    struct ArrowArray *item_pointers[1];
    const void *buffers[3];
    const void *item_buffers[3];
} array_slot;

typedef struct {
    struct ArrowArray array;
    uint32_t refs;
    canser_table *table;
    const void *no_bits[1]; /* of the array itself: all rows are valid */
    array_slot slots[];     /* one for each column; pointers to them follow */
} array_room;

static void leave_array_room(array_room *room)
{
    if (!CANSER_ADD(&room->refs, -1)) {
        canser_table_release(room->table);
        canser_memory_release(room);
    }
}

static void release_array(struct ArrowArray *array)
{
    for (int64_t i = 0; i < array->n_children; i++) {
        struct ArrowArray *const child = array->children[i];
        if (child->release)
            child->release(child);
    }
    if (array->dictionary && array->dictionary->release)
        array->dictionary->release(array->dictionary);
    array->release = NULL;
    leave_array_room(array->private_data);
}

int canser_table_array(canser_table *self, struct ArrowArray **array)
{
    if (!array)
        return CANSER_NULL;
    *array = NULL;
    if (!self)
        return CANSER_NULL;
    const size_t count = self->column_count;
    array_room *const room = canser_memory_get(
        sizeof *room + count * (sizeof *room->slots + sizeof(struct ArrowArray *)));
    if (!room)
        return CANSER_NO_MEMORY;
    struct ArrowArray **const pointers = (struct ArrowArray **)(void *)&room->slots[count];
    *room = (array_room){
        .array = {.length = (int64_t)self->row_count,
                  .n_buffers = 1,
                  .n_children = (int64_t)count,
                  .buffers = room->no_bits,
                  .children = pointers,
                  .release = release_array,
                  .private_data = room},
        .refs = 2,
        .table = self,
    };
    for (size_t i = 0; i < count; i++) {
        const table_column *const column = &self->columns[i];
        array_slot *const slot = &room->slots[i];
        const bool is_list = column->kind == CANSER_COLUMN_LIST;
        slot->buffers[0] = column->valid;
        slot->buffers[1] = column->values;
        slot->buffers[2] = column->texts;
        slot->item_buffers[0] = NULL;
        slot->item_buffers[1] = column->ends ? column->ends : column->values;
        slot->item_buffers[2] = column->texts;
        slot->item = (struct ArrowArray){
            .length = is_list ? (int64_t)self->row_count * list_len(column) : column->text_count,
            .n_buffers = column->ends ? 3 : 2,
            .buffers = slot->item_buffers,
            .release = release_array,
            .private_data = room,
        };
        slot->item_pointers[0] = &slot->item;
        slot->column = (struct ArrowArray){
            .length = (int64_t)self->row_count,
            .null_count = column->null_count,
            .n_buffers = is_list                              ? 1
                         : column->kind == CANSER_COLUMN_TEXT ? 3
                                                              : 2,
            .n_children = child_count(column),
            .buffers = slot->buffers,
            .children = slot->item_pointers,
            .dictionary = column->ends ? &slot->item : NULL,
            .release = release_array,
            .private_data = room,
        };
        room->refs += 1 + (uint32_t)child_count(column) + (column->ends != NULL);
        pointers[i] = &slot->column;
    }
    canser_table_share(self);
    *array = &room->array;
    return CANSER_OK;
}

void canser_array_free(struct ArrowArray *array)
{
    if (!array)
        return;
    if (array->release)
        array->release(array);
    leave_array_room((array_room *)(void *)array);
}

/* The room of a stream, as that of a schema. It keeps the table. */
typedef struct {
    struct ArrowArrayStream stream;
    uint32_t refs;
    bool is_done;
    const char *error; /* of the last call; NULL: none */
    canser_table *table;
} stream_room;

static void leave_stream_room(stream_room *room)
{
    if (!CANSER_ADD(&room->refs, -1)) {
        canser_table_release(room->table);
        canser_memory_release(room);
    }
}

static int note(stream_room *room, int status)
{
    room->error = status ? "canser: out of memory" : NULL;
    return status ? ENOMEM : 0;
}

static int stream_schema(struct ArrowArrayStream *stream, struct ArrowSchema *out)
{
    stream_room *const room = stream->private_data;
    struct ArrowSchema *schema;
    const int status = canser_table_schema(room->table, &schema);

    if (!status) {
        *out = *schema;
        schema->release = NULL;
        canser_schema_free(schema);
    }
    return note(room, status);
}

static int stream_next(struct ArrowArrayStream *stream, struct ArrowArray *out)
{
    stream_room *const room = stream->private_data;
    struct ArrowArray *array;

    if (room->is_done) {
        *out = (struct ArrowArray){.release = NULL};
        return note(room, CANSER_OK);
    }
    const int status = canser_table_array(room->table, &array);
    if (!status) {
        *out = *array;
        array->release = NULL;
        canser_array_free(array);
        room->is_done = true;
    }
    return note(room, status);
}

static const char *stream_error(struct ArrowArrayStream *stream)
{
    const stream_room *const room = stream->private_data;
    return room->error;
}

static void release_stream(struct ArrowArrayStream *stream)
{
    stream->release = NULL;
    leave_stream_room(stream->private_data);
}

int canser_table_stream(canser_table *self, struct ArrowArrayStream **stream)
{
    if (!stream)
        return CANSER_NULL;
    *stream = NULL;
    if (!self)
        return CANSER_NULL;
    stream_room *const room = canser_memory_get(sizeof *room);
    if (!room)
        return CANSER_NO_MEMORY;
    *room = (stream_room){
        .stream = {stream_schema, stream_next, stream_error, release_stream, room},
        .refs = 2,
        .table = self,
    };
    canser_table_share(self);
    *stream = &room->stream;
    return CANSER_OK;
}

void canser_array_stream_free(struct ArrowArrayStream *stream)
{
    if (!stream)
        return;
    if (stream->release)
        stream->release(stream);
    leave_stream_room((stream_room *)(void *)stream);
}
