/* Tables: frames as columns of Arrow, which other programs take without a copy.
 *
 *     ts       i64, nanoseconds; null: not known        format "tsn:UTC" or "tDn"
 *     channel  u8, from 0; null: not told               "C"
 *     sent     bit; null: not told                      "b"
 *     id       u32                                      "I"
 *     ext, rtr, err                                     bits, "b"
 *     dlc      u8                                       "C"
 *     data     8 bytes                                  "w:8"
 *
 * Bits of a column, and those that tell which values are not null, stand 8 to a byte, the first
 * one lowest. This is the one file that allocates: the takers of a table own its memory together,
 * and the last one gives it back. A taker may move a struct away from where it was made, and
 * release it anywhere, in any order. So all structs of one export stand in one room, which is freed
 * when the last of them is released.
 *
 * Source: arrow.apache.org, The Arrow C data interface, The Arrow C stream interface, Arrow
 * columnar format.
 */
#include "arrow.h"

#include "protocol.h"

#include <errno.h>
#include <stdlib.h>

/* A test names its own functions here, to let the first one fail, and to count. */
#ifdef CANSER_MALLOC
void *CANSER_MALLOC(size_t size);
void CANSER_FREE(void *p);
#else
#define CANSER_MALLOC malloc
#define CANSER_FREE   free
#endif

/* The columns, in their order. */
typedef enum { TS, CHANNEL, SENT, ID, EXT, RTR, ERR, DLC, DATA, COLUMN_COUNT } column;

static const char *const names[COLUMN_COUNT] = {"ts",  "channel", "sent", "id",  "ext",
                                                "rtr", "err",     "dlc",  "data"};
static const char *const formats[COLUMN_COUNT] = {"tDn", "C", "b", "I", "b", "b", "b", "C", "w:8"};
static const uint8_t value_bits[COLUMN_COUNT] = {64, 8, 1, 32, 1, 1, 1, 8, 64};

/* Columns begin at multiples of this, and are padded to it with zeros, as Arrow recommends. */
enum { ALIGNMENT = 64 };

/* More frames than this do not fit into any memory: a row takes less than 32 bytes. */
#define FRAMES_MOST (SIZE_MAX / 64)

struct canser_table {
    uint32_t refs; /* the caller, and each array and stream */
    uint8_t is_dated;
    size_t frame_count;
    int64_t null_counts[COLUMN_COUNT];
    uint8_t *valid[COLUMN_COUNT]; /* the bits of values that are not null; NULL: all are valid */
    uint8_t *values[COLUMN_COUNT];
};

CANSER_INLINE size_t padded(size_t size)
{
    return (size + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

CANSER_INLINE size_t bits_len(size_t count, size_t bits)
{
    return padded(count / 8 * bits + (count % 8 * bits + 7) / 8);
}

/* Take the next `size` bytes, and zero the last ones, of which some are padding. */
static uint8_t *take(uint8_t **at, size_t size)
{
    uint8_t *const taken = *at;

    if (size)
        memset(taken + size - ALIGNMENT, 0, ALIGNMENT);
    *at += size;
    return taken;
}

/* Copy up to 8 frames, which are one byte of each column of bits. `to` is a copy of the table: so
 * the compiler knows that no byte of a column is one of its pointers. */
CANSER_INLINE void fill_byte(const canser_table *to, int64_t *null_counts,
                             const canser_frame *frames, const uint8_t *channels,
                             const uint8_t *directions, size_t first, size_t count)
{
    unsigned ext = 0, rtr = 0, err = 0, known = 0, told = 0, sent = 0;
    uint8_t *const ts = to->values[TS] + 8 * first, *const id = to->values[ID] + 4 * first,
                   *const dlc = to->values[DLC] + first, *const data = to->values[DATA] + 8 * first;

    for (size_t i = 0; i < count; i++) {
        const canser_frame *const frame = frames + first + i;
        memcpy(ts + 8 * i, &frame->ts, sizeof frame->ts);
        memcpy(id + 4 * i, &frame->id, sizeof frame->id);
        memcpy(data + 8 * i, frame->data, sizeof frame->data);
        dlc[i] = frame->dlc;
        known |= (unsigned)(frame->ts != CANSER_NO_TIME) << i;
        ext |= (unsigned)(frame->ext != 0) << i;
        rtr |= (unsigned)(frame->rtr != 0) << i;
        err |= (unsigned)(frame->err != 0) << i;
        null_counts[TS] += frame->ts == CANSER_NO_TIME;
    }
    to->valid[TS][first / 8] = (uint8_t)known;
    to->values[EXT][first / 8] = (uint8_t)ext;
    to->values[RTR][first / 8] = (uint8_t)rtr;
    to->values[ERR][first / 8] = (uint8_t)err;
    if (channels) {
        memcpy(to->values[CHANNEL] + first, channels + first, count);
        for (size_t i = 0; i < count; i++) {
            told |= (unsigned)(channels[first + i] != CANSER_NO_CHANNEL) << i;
            null_counts[CHANNEL] += channels[first + i] == CANSER_NO_CHANNEL;
        }
        to->valid[CHANNEL][first / 8] = (uint8_t)told;
    }
    if (directions) {
        for (size_t i = 0; i < count; i++)
            sent |= (unsigned)(directions[first + i] == CANSER_SENT) << i;
        to->values[SENT][first / 8] = (uint8_t)sent;
    }
}

static void fill(canser_table *self, const canser_frame *frames, const uint8_t *channels,
                 const uint8_t *directions)
{
    const canser_table to = *self;
    const size_t count = to.frame_count, whole = count / 8 * 8;
    int64_t null_counts[COLUMN_COUNT] = {0};

    for (size_t first = 0; first < whole; first += 8)
        fill_byte(&to, null_counts, frames, channels, directions, first, 8);
    if (whole < count)
        fill_byte(&to, null_counts, frames, channels, directions, whole, count - whole);
    memcpy(self->null_counts, null_counts, sizeof null_counts);
    if (!channels) {
        if (count)
            memset(self->values[CHANNEL], CANSER_NO_CHANNEL, count);
        memset(self->valid[CHANNEL], 0, bits_len(count, 1));
        self->null_counts[CHANNEL] = (int64_t)count;
    }
    if (!directions) {
        memset(self->values[SENT], 0, bits_len(count, 1));
        self->valid[SENT] = self->values[SENT];
        self->null_counts[SENT] = (int64_t)count;
    }
    for (int i = 0; i < COLUMN_COUNT; i++) {
        if (!self->null_counts[i])
            self->valid[i] = NULL;
    }
}

int canser_table_new(const canser_frame *frames, const uint8_t *channels, const uint8_t *directions,
                     size_t frame_count, int is_dated, canser_table **table)
{
    size_t size = padded(sizeof(canser_table)) + ALIGNMENT;

    if (!table)
        return CANSER_NULL;
    *table = NULL;
    if (frame_count && !frames)
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    if (frame_count > FRAMES_MOST)
        return CANSER_NO_MEMORY;
    for (int i = 0; i < COLUMN_COUNT; i++)
        size += bits_len(frame_count, value_bits[i]);
    size += 2 * bits_len(frame_count, 1);

    canser_table *const self = CANSER_MALLOC(size);
    if (!self)
        return CANSER_NO_MEMORY;
    *self =
        (canser_table){.refs = 1, .is_dated = (uint8_t)(is_dated != 0), .frame_count = frame_count};
    uint8_t *at = (uint8_t *)self + sizeof *self;
    at += (ALIGNMENT - (uintptr_t)at % ALIGNMENT) % ALIGNMENT;
    for (int i = 0; i < COLUMN_COUNT; i++)
        self->values[i] = take(&at, bits_len(frame_count, value_bits[i]));
    self->valid[TS] = take(&at, bits_len(frame_count, 1));
    self->valid[CHANNEL] = take(&at, bits_len(frame_count, 1));
    fill(self, frames, channels, directions);
    *table = self;
    return CANSER_OK;
}

void canser_table_release(canser_table *self)
{
    if (self && !CANSER_ADD(&self->refs, -1))
        CANSER_FREE(self);
}

/* The room of a schema: it is freed when its maker has freed it, and the schema and all of its
 * children are released. The struct that the maker gets is the first one, so the room begins
 * there. A struct that was moved away finds the room by its private data. */
typedef struct {
    struct ArrowSchema schema;
    uint32_t refs;
    struct ArrowSchema children[COLUMN_COUNT];
    struct ArrowSchema *child_pointers[COLUMN_COUNT];
} schema_room;

static void leave_schema_room(schema_room *room)
{
    if (!CANSER_ADD(&room->refs, -1))
        CANSER_FREE(room);
}

static void release_schema(struct ArrowSchema *schema)
{
    for (int64_t i = 0; i < schema->n_children; i++) {
        struct ArrowSchema *const child = schema->children[i];
        if (child->release)
            child->release(child);
    }
    schema->release = NULL;
    leave_schema_room(schema->private_data);
}

int canser_table_schema(const canser_table *self, struct ArrowSchema **schema)
{
    if (!schema)
        return CANSER_NULL;
    *schema = NULL;
    if (!self)
        return CANSER_NULL;
    schema_room *const room = CANSER_MALLOC(sizeof *room);
    if (!room)
        return CANSER_NO_MEMORY;
    *room = (schema_room){
        .schema = {.format = "+s",
                   .name = "",
                   .n_children = COLUMN_COUNT,
                   .children = room->child_pointers,
                   .release = release_schema,
                   .private_data = room},
        .refs = 2 + COLUMN_COUNT,
    };
    for (int i = 0; i < COLUMN_COUNT; i++) {
        room->children[i] = (struct ArrowSchema){
            .format = i == TS && self->is_dated ? "tsn:UTC" : formats[i],
            .name = names[i],
            .flags = ARROW_FLAG_NULLABLE,
            .release = release_schema,
            .private_data = room,
        };
        room->child_pointers[i] = &room->children[i];
    }
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
    struct ArrowArray array;
    uint32_t refs;
    canser_table *table;
    struct ArrowArray children[COLUMN_COUNT];
    struct ArrowArray *child_pointers[COLUMN_COUNT];
    const void *buffers[COLUMN_COUNT][2];
    const void *no_bits[1]; /* of the array itself: all rows are valid */
} array_room;

static void leave_array_room(array_room *room)
{
    if (!CANSER_ADD(&room->refs, -1)) {
        canser_table_release(room->table);
        CANSER_FREE(room);
    }
}

static void release_array(struct ArrowArray *array)
{
    for (int64_t i = 0; i < array->n_children; i++) {
        struct ArrowArray *const child = array->children[i];
        if (child->release)
            child->release(child);
    }
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
    array_room *const room = CANSER_MALLOC(sizeof *room);
    if (!room)
        return CANSER_NO_MEMORY;
    *room = (array_room){
        .array = {.length = (int64_t)self->frame_count,
                  .n_buffers = 1,
                  .n_children = COLUMN_COUNT,
                  .buffers = room->no_bits,
                  .children = room->child_pointers,
                  .release = release_array,
                  .private_data = room},
        .refs = 2 + COLUMN_COUNT,
        .table = self,
    };
    for (int i = 0; i < COLUMN_COUNT; i++) {
        room->buffers[i][0] = self->valid[i];
        room->buffers[i][1] = self->values[i];
        room->children[i] = (struct ArrowArray){
            .length = (int64_t)self->frame_count,
            .null_count = self->null_counts[i],
            .n_buffers = 2,
            .buffers = room->buffers[i],
            .release = release_array,
            .private_data = room,
        };
        room->child_pointers[i] = &room->children[i];
    }
    CANSER_ADD(&self->refs, 1);
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
        CANSER_FREE(room);
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
    stream_room *const room = CANSER_MALLOC(sizeof *room);
    if (!room)
        return CANSER_NO_MEMORY;
    *room = (stream_room){
        .stream = {stream_schema, stream_next, stream_error, release_stream, room},
        .refs = 2,
        .table = self,
    };
    CANSER_ADD(&self->refs, 1);
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
