/* Captures of CAN frames: packets of pcap and pcapng, read and written.
 *
 *     pcap     seconds u32, their fraction u32, captured length u32, original length u32, bytes
 *
 *     pcapng   type 6 u32, total length u32, interface u32, time u32 (high), u32 (low),
 *              captured length u32, original length u32, bytes, padded to a multiple of 4,
 *              options: code u16, length u16, value, padded to a multiple of 4; the last is 0, 0
 *              total length u32
 *
 * The bytes of a packet, by the link type of its interface:
 *
 *     227      id u32, big-endian, with flags in bits 31..29: extended, remote, error;
 *              length, flags of CAN FD, 2 bytes, data
 *     113      packet type u16 (4 is sent), 12 bytes, protocol u16, all big-endian;
 *              then as 227, but the id is in the byte order of the file
 *
 * Source: draft-ietf-opsawg-pcap, draft-ietf-opsawg-pcapng, www.tcpdump.org/linktypes; Linux,
 * include/uapi/linux/can.h. Old kernels left any values in the bytes behind the length.
 */
#include "protocol.h"

enum {
    RECORD_HEAD = 16,
    BLOCK_HEAD = 28,
    BLOCK_MIN = BLOCK_HEAD + 4,
    CAN_HEAD = 8,
    CAN_LEN = 16, /* a frame of classic CAN with all 8 bytes of data */
    FD_LEN = 72,  /* a frame of CAN FD with all 64 bytes */
    FD_DATA_MAX = 64,
    XL_HEAD = 12,
    COOKED_HEAD = 16,
    ENHANCED = 6 /* type of a block */
};

/* Flags in the id, in the byte of CAN XL, and in that of CAN FD with the bits that are always 0. */
#define FLAG_EXT 0x80000000u
#define FLAG_RTR 0x40000000u
#define FLAG_ERR 0x20000000u
enum { FLAG_XL = 0x80, FLAG_FD = 0x04, FD_ZEROS = 0xF8 };

/* Protocols in the header of link type 113, and the packet type of a frame that was sent. */
enum { COOKED_CAN = 0x0C, COOKED_FD = 0x0D, COOKED_XL = 0x0E, COOKED_SENT = 4 };

/* Codes of a packet's options, and the direction in the flags. */
enum { OPTION_COMMENT = 1, OPTION_FLAGS = 2, OPTION_DROPPED = 4, INBOUND = 1, OUTBOUND = 2 };

/* What a place in a capture holds. */
typedef enum { TAKEN, NOT_WHOLE, UNUSUAL } found;

CANSER_INLINE uint32_t swap_bytes(uint32_t value)
{
    return value >> 24 | (value >> 8 & 0xFF00) | (value & 0xFF00) << 8 | value << 24;
}

CANSER_INLINE uint32_t load_u32(const uint8_t *p, bool is_big)
{
    return is_big ? swap_bytes(load_le32(p)) : load_le32(p);
}

CANSER_INLINE uint32_t load_u16(const uint8_t *p, bool is_big)
{
    return is_big ? (uint32_t)p[0] << 8 | p[1] : load_le16(p);
}

int canser_interface_init(canser_interface *self, uint32_t link_type, uint8_t channel,
                          uint8_t resolution, int64_t offset_ns)
{
    if (!self)
        return CANSER_NULL;
    const unsigned places = resolution & 0x7F;
    *self = (canser_interface){.scale = 1,
                               .divide = 1,
                               .offset_ns = offset_ns,
                               .link_type = link_type,
                               .shift = (uint8_t)places,
                               .is_binary = resolution >> 7,
                               .channel = channel};
    for (unsigned i = places; i < 9; i++)
        self->scale *= 10;
    self->most = places < 9 ? INT64_MAX / self->scale : UINT64_MAX;
    if (places > 9 + 19) /* 10^20 does not fit: all times are 0 */
        self->divide = 0;
    for (unsigned i = 9; i < places && self->divide; i++)
        self->divide *= 10;
    return CANSER_OK;
}

/* Set the nanoseconds of a time; false if they do not fit. */
CANSER_INLINE bool to_ns(const canser_interface *from, uint64_t ticks, int64_t *ns)
{
    uint64_t value;

    if (CANSER_LIKELY(!from->is_binary)) {
        if (ticks > from->most)
            return false;
        value = ticks * from->scale;
        if (from->divide != 1)
            value = from->divide ? value / from->divide : 0;
    } else {
        /* The product with 10^9 has up to 94 bits. */
        const uint64_t low = ticks * 1000000000,
                       high = ((ticks >> 32) * 1000000000 +
                               ((ticks & UINT32_MAX) * 1000000000 >> 32)) >>
                              32;
        if (from->shift >= 64)
            value = high >> (from->shift - 64);
        else if (from->shift ? high >> (from->shift - 1) : high)
            return false;
        else
            value = from->shift ? high << (64 - from->shift) | low >> from->shift : low;
    }
    if (value > INT64_MAX ||
        (from->offset_ns > 0 && value > (uint64_t)(INT64_MAX - from->offset_ns)))
        return false;
    *ns = (int64_t)value + from->offset_ns;
    return true;
}

/* Take a packet of `len` bytes into the next row, or count it. `direction`: that of the flags, 0 if
 * they tell none. */
CANSER_INLINE void take_packet(canser_capture *self, const canser_interface *from, const uint8_t *p,
                               size_t len, bool is_big, unsigned direction, int64_t ts,
                               canser_rows *rows)
{
    const bool is_cooked = from->link_type == CANSER_LINK_COOKED;
    uint32_t protocol = COOKED_CAN;

    if (is_cooked) {
        if (len < COOKED_HEAD) {
            self->cut_count++;
            return;
        }
        protocol = load_u16(p + 14, true);
        if (!direction && load_u16(p, true) == COOKED_SENT)
            direction = OUTBOUND;
        p += COOKED_HEAD;
        len -= COOKED_HEAD;
    } else if (from->link_type != CANSER_LINK_CAN) {
        protocol = 0;
    }
    if (protocol < COOKED_CAN || protocol > COOKED_XL) {
        self->other_count++;
        return;
    }
    if (len < CAN_HEAD) {
        self->cut_count++;
        return;
    }
    const size_t dlc = p[4];
    if (protocol == COOKED_XL || (dlc & FLAG_XL && len >= XL_HEAD)) {
        self->xl_count++;
        return;
    }
    if (protocol == COOKED_FD || (dlc > DLC_MAX && dlc <= FD_DATA_MAX) ||
        (!is_cooked && (len == FD_LEN || (p[5] & FLAG_FD && !(p[5] & FD_ZEROS) && !p[6])))) {
        self->fd_count++;
        return;
    }
    const uint32_t word = load_u32(p, is_cooked ? is_big : true), id = word & ID_EXT_MAX;
    const unsigned rtr = word >> 30 & 1, err = word >> 29 & 1;
    /* The classes of an error have 29 bits, and mostly no flag of an extended id. */
    const unsigned ext = word >> 31 | (err && id > ID_STD_MAX);
    if (dlc > DLC_MAX || (!ext && id > ID_STD_MAX)) {
        self->bad_count++;
        return;
    }
    if (!rtr && dlc > len - CAN_HEAD) {
        self->cut_count++;
        return;
    }
    const size_t row = rows->frame_count++;
    canser_frame *const frame = &rows->frames[row];
    if (CANSER_LIKELY(len >= CAN_LEN)) {
        store_frame(frame, id, ext, rtr, err, dlc, p + CAN_HEAD);
    } else {
        uint8_t data[DLC_MAX] = {0};
        memcpy(data, p + CAN_HEAD, len - CAN_HEAD);
        store_frame(frame, id, ext, rtr, err, dlc, data);
    }
    frame->ts = ts;
    rows->channels[row] = from->channel;
    rows->directions[row] = direction == OUTBOUND ? CANSER_SENT : CANSER_RECEIVED;
}

/* Take the options of a packet; return the direction that the flags tell, 0 if they tell none. */
CANSER_INLINE unsigned take_options(canser_capture *self, const uint8_t *p, const uint8_t *end,
                                    bool is_big)
{
    unsigned direction = 0;

    while (end - p >= 4) {
        const uint32_t code = load_u16(p, is_big), len = load_u16(p + 2, is_big);
        p += 4;
        if (!code || len > (size_t)(end - p))
            break;
        if (code == OPTION_FLAGS && len == 4) {
            direction = load_u32(p, is_big) & 3;
        } else if (code == OPTION_DROPPED && len == 8) {
            const uint64_t first = load_u32(p, is_big), second = load_u32(p + 4, is_big);
            self->dropped_count += is_big ? first << 32 | second : second << 32 | first;
        } else if (code == OPTION_COMMENT) {
            self->comment_count++;
        }
        p += (len + 3) / 4 * 4; /* the end of the options is a multiple of 4 bytes away */
    }
    return direction;
}

CANSER_INLINE found take_block(canser_capture *self, const uint8_t *p, size_t left, bool is_big,
                               canser_rows *rows, size_t *total)
{
    int64_t ts;

    if (left < 8)
        return NOT_WHOLE;
    *total = load_u32(p + 4, is_big);
    if (load_u32(p, is_big) != ENHANCED || *total < BLOCK_MIN || *total > CANSER_BLOCK_MAX ||
        *total % 4)
        return UNUSUAL;
    if (*total > left)
        return NOT_WHOLE;
    const uint32_t number = load_u32(p + 8, is_big), len = load_u32(p + 20, is_big);
    const uint64_t ticks = (uint64_t)load_u32(p + 12, is_big) << 32 | load_u32(p + 16, is_big);
    if (load_u32(p + *total - 4, is_big) != *total || number >= self->interface_count ||
        len > *total - BLOCK_MIN || !to_ns(&self->interfaces[number], ticks, &ts))
        return UNUSUAL;
    const unsigned direction =
        take_options(self, p + BLOCK_HEAD + (len + 3) / 4 * 4, p + *total - 4, is_big);
    take_packet(self, &self->interfaces[number], p + BLOCK_HEAD, len, is_big, direction, ts, rows);
    return TAKEN;
}

CANSER_INLINE found take_record(canser_capture *self, const uint8_t *p, size_t left, bool is_big,
                                canser_rows *rows, size_t *total)
{
    const canser_interface *const from = self->interfaces;

    if (left < RECORD_HEAD)
        return NOT_WHOLE;
    const uint32_t len = load_u32(p + 8, is_big);
    if (!len || len > CANSER_RECORD_MAX)
        return UNUSUAL;
    *total = RECORD_HEAD + len;
    if (*total > left)
        return NOT_WHOLE;
    /* At most 2^32 seconds and 2^32 microseconds: both fit 63 bits. */
    const uint64_t ns = (uint64_t)load_u32(p, is_big) * 1000000000 +
                        (uint64_t)load_u32(p + 4, is_big) * from->scale;
    take_packet(self, from, p + RECORD_HEAD, len, is_big, 0, (int64_t)ns, rows);
    return TAKEN;
}

CANSER_INLINE void read_packets(canser_capture *self, const uint8_t *data, size_t data_len,
                                bool is_blocks, bool is_big, canser_rows *rows)
{
    size_t used = 0, count = 0, total = 0;
    found what = TAKEN;

    while (used < data_len && rows->frame_count < rows->frame_cap) {
        what = (is_blocks ? take_block : take_record)(self, data + used, data_len - used, is_big,
                                                      rows, &total);
        if (what != TAKEN)
            break;
        used += total;
        count++;
    }
    rows->used = used;
    rows->line_count = count;
    rows->is_unusual = what == UNUSUAL;
}

/* Check the arrays of a call; `channels` and `directions` may be NULL. Of arrays that are only
 * read, two may overlap. Returns a status. */
static int check(const canser_capture *self, const canser_frame *frames, const uint8_t *channels,
                 const uint8_t *directions, size_t frame_cap, const uint8_t *bytes, size_t byte_cap,
                 bool writes_rows)
{
    if (!self || (!bytes && byte_cap) || (!frames && frame_cap))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    const span all[] = {span_of(bytes, byte_cap, 1), span_of(frames, frame_cap, sizeof *frames),
                        span_of(channels, frame_cap, 1), span_of(directions, frame_cap, 1)};
    for (size_t i = 1; i < 4; i++)
        for (size_t j = 0; j < (writes_rows ? i : 1); j++)
            if (spans_meet(all[i], all[j]))
                return CANSER_OVERLAP;
    return CANSER_OK;
}

int canser_capture_read(canser_capture *self, const uint8_t *data, size_t data_len,
                        canser_rows *rows)
{
    if (!rows)
        return CANSER_NULL;
    rows->used = rows->frame_count = rows->line_count = 0;
    rows->is_unusual = 0;
    if ((!rows->channels || !rows->directions) && rows->frame_cap)
        return CANSER_NULL;
    const int status = check(self, rows->frames, rows->channels, rows->directions, rows->frame_cap,
                             data, data_len, true);
    if (status)
        return status;
    if (!self->interfaces && self->interface_count)
        return CANSER_NULL;
    if (misaligned(self->interfaces, _Alignof(canser_interface)))
        return CANSER_MISALIGNED;
    if (!self->is_blocks && !self->interface_count)
        return CANSER_RANGE;

    /* A loop for each kind, in which the compiler knows the byte order. */
    if (self->is_blocks && self->is_big)
        read_packets(self, data, data_len, true, true, rows);
    else if (self->is_blocks)
        read_packets(self, data, data_len, true, false, rows);
    else if (self->is_big)
        read_packets(self, data, data_len, false, true, rows);
    else
        read_packets(self, data, data_len, false, false, rows);
    return CANSER_OK;
}

/* A packet of SocketCAN: always CAN_LEN bytes, as kernels have them. */
CANSER_INLINE void put_packet(uint8_t *out, const canser_frame *frame)
{
    const uint64_t data = load_payload(frame->data, frame->dlc & ((size_t)!!frame->rtr - 1));

    store_le32(out, swap_bytes(frame->id | (frame->ext ? FLAG_EXT : 0) |
                               (frame->rtr ? FLAG_RTR : 0) | (frame->err ? FLAG_ERR : 0)));
    store_le32(out + 4, frame->dlc);
    memcpy(out + CAN_HEAD, &data, sizeof data);
}

/* The time of a frame; 0 if it has none, or none that the format can hold. */
CANSER_INLINE uint64_t time_of(canser_capture *self, const canser_frame *frame, int64_t most)
{
    if (CANSER_LIKELY(frame->ts >= 0 && frame->ts <= most))
        return (uint64_t)frame->ts;
    if (frame->ts == CANSER_NO_TIME)
        self->unknown_times++;
    else
        self->outside_times++;
    return 0;
}

CANSER_INLINE uint8_t *put_block(canser_capture *self, const canser_frame *frame, unsigned channel,
                                 const uint8_t *direction, uint8_t *out)
{
    const uint32_t total = direction ? CANSER_CAPTURED_MAX : BLOCK_MIN + CAN_LEN;
    const uint64_t ts = time_of(self, frame, INT64_MAX);

    store_le32(out, ENHANCED);
    store_le32(out + 4, total);
    store_le32(out + 8, self->numbers[channel]);
    store_le32(out + 12, (uint32_t)(ts >> 32));
    store_le32(out + 16, (uint32_t)ts);
    store_le32(out + 20, CAN_LEN);
    store_le32(out + 24, CAN_LEN);
    put_packet(out + BLOCK_HEAD, frame);
    out += BLOCK_HEAD + CAN_LEN;
    if (direction) {
        store_le32(out, OPTION_FLAGS | 4 << 16);
        store_le32(out + 4, *direction == CANSER_SENT ? OUTBOUND : INBOUND);
        store_le32(out + 8, 0);
        out += 12;
    }
    store_le32(out, total);
    return out + 4;
}

CANSER_INLINE uint8_t *put_record(canser_capture *self, const canser_frame *frame, uint8_t *out)
{
    const uint64_t ts = time_of(self, frame, UINT32_MAX * INT64_C(1000000000) + 999999999);

    store_le32(out, (uint32_t)(ts / 1000000000));
    store_le32(out + 4, (uint32_t)(ts % 1000000000));
    store_le32(out + 8, CAN_LEN);
    store_le32(out + 12, CAN_LEN);
    put_packet(out + RECORD_HEAD, frame);
    return out + RECORD_HEAD + CAN_LEN;
}

int canser_capture_write(canser_capture *self, const canser_frame *frames, const uint8_t *channels,
                         const uint8_t *directions, size_t frame_count, uint8_t *out,
                         size_t out_cap, canser_encoded *result)
{
    if (!result)
        return CANSER_NULL;
    *result = (canser_encoded){0, 0, CANSER_REFUSAL_NONE};
    const int status = check(self, frames, channels, directions, frame_count, out, out_cap, false);
    if (status)
        return status;

    uint8_t *p = out;
    size_t i = 0;
    while (i < frame_count && (size_t)(out + out_cap - p) >= CANSER_CAPTURED_MAX) {
        result->refusal = refuse_frame(&frames[i], true, true);
        if (result->refusal)
            break;
        if (self->is_blocks)
            p = put_block(self, &frames[i], channels ? channels[i] : CANSER_NO_CHANNEL,
                          directions ? &directions[i] : NULL, p);
        else
            p = put_record(self, &frames[i], p);
        i++;
    }
    result->frame_count = i;
    result->byte_count = (size_t)(p - out);
    return result->refusal ? CANSER_REFUSED : CANSER_OK;
}
