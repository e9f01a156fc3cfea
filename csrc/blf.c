/* Objects of Vector's BLF files as frames, and frames as objects.
 *
 *   0  LOBJ, u16 header size, u16 header version, u32 size of all, u32 type
 *  16  u32 flags (1: times in 10 us, 2: in ns), u16 client, u16 version, u64 time
 *  32  with header version 2: u64 original time
 *
 * Behind the header lies what the type says. Behind an object there is padding: size % 4 bytes as
 * Vector's and most other programs write it, or up to a multiple of 8. All numbers are
 * little-endian. A container (type 10) has no flags and no time; the caller inflates it.
 *
 * Source: files of Vector's programs; the headers of vector_blf; python-can, can.io.blf.
 */
#include "protocol.h"

/* The types of objects that tell frames. */
enum {
    TYPE_MESSAGE = 1,      /* u16 channel, u8 flags, u8 dlc, u32 id, 8 bytes of data */
    TYPE_ERROR = 2,        /* u16 channel, u16 length */
    TYPE_CONTAINER = 10,   /* u16 method, 6 bytes, u32 inflated size, 4 bytes, content */
    TYPE_ERROR_EXT = 73,   /* u16 channel, u16 length, u32 flags, u8 ecc, u8 position, u8 dlc, 1
                            * byte, u32 length in ns, u32 id, u16 flags, 2 bytes, 8 bytes of data */
    TYPE_MESSAGE2 = 86,    /* as 1; u32 length in ns, u8 bits, 3 bytes */
    TYPE_FD = 100,         /* u16 channel, u8 flags, u8 dlc, u32 id, u32 length in ns, u8 bits, u8
                            * FD flags, u8 count of data bytes, 5 bytes, data */
    TYPE_FD_64 = 101,      /* u8 channel, u8 dlc, u8 count of data bytes, 1 byte, u32 id, u32 length
                            * in ns, u32 flags, 18 bytes, u8 direction, 5 bytes, data */
    TYPE_FD_ERROR_64 = 104 /* an error frame of CAN FD */
};

/* Bytes of headers, and of what is read behind them. */
enum {
    BASE_LEN = 16,
    HEADER_LEN = 32,
    CONTAINER_LEN = 32,
    MESSAGE_LEN = 16,
    ERROR_LEN = 4,
    ERROR_EXT_LEN = 32,
    FD_LEN = 20,
    FD_64_LEN = 40,
    MESSAGE2_LEN = 24 /* as it is written */
};

/* The most bytes of padding between two objects. */
enum { PADDING_MOST = 8 };

/* The largest dlc on the wire: in a frame of classic CAN 9 to 15 mean 8 bytes. */
enum { RAW_DLC_MAX = 15 };

#define ID_EXT UINT32_C(0x80000000)

/* Flags of types 1, 86 and 100; of FD flags of 100; of 101; of 73. */
enum { FLAG_SENT = 1, FLAG_REMOTE = 0x80 };
enum { FD_EDL = 1 };
enum { FD_64_REMOTE = 0x10, FD_64_EDL = 0x1000 };
enum { ERROR_RECEIVED = 0x2020, ERROR_SENT = 0x4000 };

static const uint8_t signature[4] = {'L', 'O', 'B', 'J'};

/* What an object is. */
typedef enum { OBJECT_FRAME, OBJECT_OTHER, OBJECT_SHORT } object_kind;

CANSER_INLINE uint64_t load_le64(const uint8_t *p)
{
    return load_le32(p) | (uint64_t)load_le32(p + 4) << 32;
}

CANSER_INLINE void store_le16(uint8_t *p, uint32_t value)
{
    p[0] = (uint8_t)value;
    p[1] = (uint8_t)(value >> 8);
}

CANSER_INLINE void store_le64(uint8_t *p, uint64_t value)
{
    store_le32(p, (uint32_t)value);
    store_le32(p + 4, (uint32_t)(value >> 32));
}

/* The code of a channel by its number. */
CANSER_INLINE uint8_t channel_code(canser_blf *self, uint32_t number)
{
    self->lost_channels += number > CANSER_NO_CHANNEL;
    return (uint8_t)(number && number <= CANSER_NO_CHANNEL ? number - 1 : CANSER_NO_CHANNEL);
}

/* The time of an object in nanoseconds. */
CANSER_INLINE int64_t load_time(canser_blf *self, const uint8_t *object)
{
    const uint64_t scale = load_le32(object + 16) == 1 ? 10000 : 1;
    const uint64_t time = load_le64(object + 24);

    if (CANSER_LIKELY(time <= INT64_MAX / scale))
        return (int64_t)(time * scale);
    self->lost_times++;
    return CANSER_NO_TIME;
}

/* A frame of classic CAN as an object tells it. */
typedef struct {
    uint32_t channel;
    uint32_t id; /* with ID_EXT */
    uint32_t dlc;
    bool rtr;
    bool err;
    bool sent;
    const uint8_t *data; /* eight bytes */
} told_frame;

/* Store a frame into the row at an index, if it is one of classic CAN. */
CANSER_INLINE object_kind put(canser_blf *self, const uint8_t *object, const told_frame *told,
                              const canser_rows *rows, size_t index)
{
    const bool ext = (told->id & ID_EXT) != 0;
    const uint32_t id = told->id & ~ID_EXT;
    const size_t dlc = told->dlc < DLC_MAX ? told->dlc : DLC_MAX;

    if (id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX) || told->dlc > RAW_DLC_MAX) {
        self->odd_frames++;
        return OBJECT_OTHER;
    }
    store_frame(&rows->frames[index], id, ext, told->rtr, told->err, dlc, told->data);
    rows->frames[index].ts = load_time(self, object);
    rows->channels[index] = channel_code(self, told->channel);
    rows->directions[index] = told->sent ? CANSER_SENT : CANSER_RECEIVED;
    return OBJECT_FRAME;
}

/* Store an error frame. Other programs fill its id and dlc with anything: they are cut. */
static object_kind put_error(canser_blf *self, const uint8_t *object, told_frame told,
                             const canser_rows *rows, size_t index)
{
    uint32_t id = told.id & ID_EXT_MAX;

    self->odd_errors += id != (told.id & ~ID_EXT) || told.dlc > RAW_DLC_MAX;
    if (told.dlc > DLC_MAX)
        told.dlc = DLC_MAX;
    /* The class of an error may have more than 11 bits, without a word on the frame's kind. */
    if (id > ID_STD_MAX || told.id & ID_EXT)
        id |= ID_EXT;
    told.id = id;
    told.err = true;
    return put(self, object, &told, rows, index);
}

/* Store a frame of a channel of CAN FD, which may be one of classic CAN. `len` is the number of
 * bytes from told->data to the end of the object, `count` the number of its data bytes. */
static object_kind put_of_fd(canser_blf *self, const uint8_t *object, told_frame told, size_t len,
                             size_t count, const canser_rows *rows, size_t index)
{
    uint8_t data[DLC_MAX] = {0};

    if (told.rtr)
        count = 0;
    else if (count <= DLC_MAX)
        told.dlc = (uint32_t)count;
    else
        told.dlc = RAW_DLC_MAX + 1; /* no frame of classic CAN has so many */
    if (count > len)
        return OBJECT_SHORT;
    memcpy(data, told.data, count < DLC_MAX ? count : DLC_MAX);
    told.data = data;
    return put(self, object, &told, rows, index);
}

/* Read a whole object of `size` bytes. */
static object_kind read_object(canser_blf *self, const uint8_t *object, size_t size,
                               const canser_rows *rows, size_t index)
{
    static const uint8_t zeros[DLC_MAX];
    const uint32_t type = load_le32(object + 12);
    const size_t header_len = load_le16(object + 4);
    const uint8_t *const p = object + header_len;
    size_t least;

    switch (type) {
    case TYPE_MESSAGE:
    case TYPE_MESSAGE2:
        least = MESSAGE_LEN;
        break;
    case TYPE_ERROR:
        least = ERROR_LEN;
        break;
    case TYPE_ERROR_EXT:
        least = ERROR_EXT_LEN;
        break;
    case TYPE_FD:
        least = FD_LEN;
        break;
    case TYPE_FD_64:
        least = FD_64_LEN;
        break;
    case TYPE_FD_ERROR_64:
        self->fd_count++;
        return OBJECT_OTHER;
    default:
        return OBJECT_OTHER;
    }
    if (header_len < HEADER_LEN || size < header_len + least)
        return OBJECT_SHORT;
    const size_t len = size - header_len - least;

    told_frame told = {.channel = load_le16(p), .data = zeros};
    switch (type) {
    case TYPE_ERROR:
        return put_error(self, object, told, rows, index);
    case TYPE_ERROR_EXT:
        told.dlc = p[10];
        told.id = load_le32(p + 16);
        told.sent = (load_le16(p + 20) & ERROR_SENT) != 0;
        told.data = p + 24;
        return put_error(self, object, told, rows, index);
    case TYPE_FD_64:
        if (load_le32(p + 12) & FD_64_EDL) {
            self->fd_count++;
            return OBJECT_OTHER;
        }
        told.channel = p[0];
        told.dlc = p[1];
        told.id = load_le32(p + 4);
        told.rtr = (load_le32(p + 12) & FD_64_REMOTE) != 0;
        told.sent = p[34] != 0;
        told.data = p + FD_64_LEN;
        return put_of_fd(self, object, told, len, p[2], rows, index);
    default:
        told.rtr = (p[2] & FLAG_REMOTE) != 0;
        told.sent = (p[2] & FLAG_SENT) != 0;
        told.dlc = p[3];
        told.id = load_le32(p + 4);
        if (type != TYPE_FD) {
            told.data = p + 8;
            return put(self, object, &told, rows, index);
        }
        if (p[13] & FD_EDL) {
            self->fd_count++;
            return OBJECT_OTHER;
        }
        told.data = p + FD_LEN;
        return put_of_fd(self, object, told, len, p[14], rows, index);
    }
}

/* Check the arrays of a call; `channels` and `directions` may be NULL. Returns a status. */
static int check(const canser_blf *self, const canser_frame *frames, const uint8_t *channels,
                 const uint8_t *directions, size_t frame_cap, const uint8_t *bytes, size_t byte_cap)
{
    if (!self || (!bytes && byte_cap) || (!frames && frame_cap))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    const span all[] = {span_of(frames, frame_cap, sizeof *frames), span_of(channels, frame_cap, 1),
                        span_of(directions, frame_cap, 1), span_of(bytes, byte_cap, 1)};
    for (size_t i = 0; i < 4; i++)
        for (size_t j = 0; j < i; j++)
            if (spans_meet(all[i], all[j]))
                return CANSER_OVERLAP;
    return CANSER_OK;
}

/* Take objects; return why it stopped. */
static int read_objects(canser_blf *self, const uint8_t *data, size_t data_len, canser_rows *rows)
{
    size_t pos = 0;

    while (rows->frame_count < rows->frame_cap) {
        const size_t left = data_len - pos;
        size_t padding = 0;

        while (padding + sizeof signature <= left && padding <= PADDING_MOST &&
               memcmp(data + pos + padding, signature, sizeof signature) != 0)
            padding++;
        if (padding > PADDING_MOST)
            return CANSER_BLF_SIGNATURE;
        if (left - padding < BASE_LEN)
            return CANSER_BLF_MORE;
        pos += padding;
        rows->used = pos;

        const uint8_t *const object = data + pos;
        const uint32_t size = load_le32(object + 8);
        const bool is_container = load_le32(object + 12) == TYPE_CONTAINER;
        self->size = size;
        if (size < (is_container ? CONTAINER_LEN : BASE_LEN) || size > CANSER_BLF_OBJECT_MAX)
            return CANSER_BLF_SIZE;
        if (is_container)
            return CANSER_BLF_CONTAINER;
        if (size > data_len - pos)
            return CANSER_BLF_MORE;
        const object_kind kind = read_object(self, object, size, rows, rows->frame_count);
        if (kind == OBJECT_SHORT)
            return CANSER_BLF_SIZE;
        self->size = 0;
        rows->frame_count += kind == OBJECT_FRAME;
        rows->line_count++;
        pos += size;
        rows->used = pos;
    }
    return CANSER_BLF_FULL;
}

int canser_blf_read(canser_blf *self, const uint8_t *data, size_t data_len, canser_rows *rows)
{
    if (!rows)
        return CANSER_NULL;
    rows->used = rows->frame_count = rows->line_count = 0;
    rows->is_unusual = 0;
    if ((!rows->channels || !rows->directions) && rows->frame_cap)
        return CANSER_NULL;
    const int status = check(self, rows->frames, rows->channels, rows->directions, rows->frame_cap,
                             data, data_len);
    if (status)
        return status;
    self->size = 0;
    self->stopped = read_objects(self, data, data_len, rows);
    rows->is_unusual = self->stopped == CANSER_BLF_SIGNATURE || self->stopped == CANSER_BLF_SIZE;
    return CANSER_OK;
}

/* Write a frame of classic CAN as an object; return its size. */
static size_t write_object(canser_blf *self, const canser_frame *frame, uint32_t channel, bool sent,
                           uint8_t *out)
{
    const uint32_t size = HEADER_LEN + (uint32_t)(frame->err ? ERROR_EXT_LEN : MESSAGE2_LEN);
    const uint32_t id = frame->id | (frame->ext ? ID_EXT : 0);
    const bool rtr = frame->rtr != 0, known = frame->ts != CANSER_NO_TIME,
               early = known && frame->ts < self->start_ns;
    const uint64_t data = load_payload(frame->data, rtr ? 0 : frame->dlc);
    uint8_t *const p = out + HEADER_LEN;

    self->unknown_times += !known;
    self->early_times += early;
    if (known && frame->ts > self->last_ns)
        self->last_ns = frame->ts;
    memset(out, 0, size);
    memcpy(out, signature, sizeof signature);
    store_le16(out + 4, HEADER_LEN);
    store_le16(out + 6, 1);
    store_le32(out + 8, size);
    store_le32(out + 12, frame->err ? TYPE_ERROR_EXT : TYPE_MESSAGE2);
    store_le32(out + 16, 2);
    if (known && !early)
        store_le64(out + 24, (uint64_t)frame->ts - (uint64_t)self->start_ns);
    store_le16(p, channel);
    if (frame->err) {
        self->remote_errors += rtr;
        p[10] = frame->dlc;
        store_le32(p + 16, id);
        store_le16(p + 20, sent ? ERROR_SENT : ERROR_RECEIVED);
        memcpy(p + 24, &data, sizeof data);
    } else {
        p[2] = (uint8_t)((sent ? FLAG_SENT : 0) | (rtr ? FLAG_REMOTE : 0));
        p[3] = frame->dlc;
        store_le32(p + 4, id);
        memcpy(p + 8, &data, sizeof data);
    }
    return size;
}

int canser_blf_write(canser_blf *self, const canser_frame *frames, const uint8_t *channels,
                     const uint8_t *directions, size_t frame_count, uint8_t *out, size_t out_cap,
                     canser_encoded *result)
{
    if (!result)
        return CANSER_NULL;
    *result = (canser_encoded){0, 0, CANSER_REFUSAL_NONE};
    const int status = check(self, frames, channels, directions, frame_count, out, out_cap);
    if (status)
        return status;

    size_t i = 0, len = 0;
    while (i < frame_count && out_cap - len >= CANSER_BLF_WRITTEN_MAX) {
        result->refusal = refuse_frame(&frames[i], true, true);
        if (result->refusal)
            break;
        const uint8_t channel = channels ? channels[i] : CANSER_NO_CHANNEL;
        len += write_object(self, &frames[i], channel == CANSER_NO_CHANNEL ? 1 : channel + 1u,
                            directions && directions[i] == CANSER_SENT, out + len);
        i++;
    }
    result->frame_count = i;
    result->byte_count = len;
    return result->refusal ? CANSER_REFUSED : CANSER_OK;
}
