#include "plain.h"

#include <stdlib.h>
#include <string.h>

typedef enum { FOUND_FRAME, FOUND_CONTROL, FOUND_REJECT, FOUND_MORE } found;

/* What starts at a position. */
typedef struct {
    found found;
    size_t len; /* frame, control: bytes of the packet */
    int reason; /* reject: CANSER_REJECT_* */
} finding;

static finding reject(int reason)
{
    return (finding){FOUND_REJECT, 0, reason};
}

static finding more(void)
{
    return (finding){FOUND_MORE, 0, 0};
}

static finding control(size_t len)
{
    return (finding){FOUND_CONTROL, len, 0};
}

/* A frame of `len` bytes with its payload at `payload`; the row that it fills,
 * without its time and its error flag. */
static finding frame(size_t len, canser_frame *row, uint32_t id, bool ext, bool rtr, uint8_t dlc,
                     const uint8_t *payload)
{
    memset(row, 0, sizeof *row);
    row->id = id;
    row->ext = ext;
    row->rtr = rtr;
    row->dlc = dlc;
    row->ts = CANSER_NO_TIME;
    for (int i = 0; i < dlc && !rtr; i++)
        row->data[i] = payload[i];
    return (finding){FOUND_FRAME, len, 0};
}

static uint32_t little_endian(const uint8_t *p, int byte_count)
{
    uint32_t value = 0;

    for (int i = byte_count - 1; i >= 0; i--)
        value = value * 256 + p[i];
    return value;
}

/* AA | timestamp, 4 | dlc | id, 4 | payload, dlc | BB
 *
 * All looks take the `n` bytes at hand from a position on, at least one,
 * and check them in the order in which they arrive. */
static finding look_serial(const uint8_t *p, size_t n, canser_frame *row)
{
    if (p[0] != 0xAA)
        return reject(CANSER_REJECT_MARKER);
    if (n < 6)
        return more();
    uint8_t dlc = p[5];
    if (dlc > 8)
        return reject(CANSER_REJECT_DLC);
    if (n < 10)
        return more();
    uint32_t word = little_endian(p + 6, 4);
    uint32_t id = word & 0x1FFFFFFF;
    bool ext = (word & 0x80000000) != 0 || id > 0x7FF;
    bool rtr = (word & 0x40000000) != 0;
    bool err = (word & 0x20000000) != 0;
    size_t end = 10 + (size_t)dlc;
    if (rtr) {
        if (n < 11)
            return more();
        if (p[10] == 0xBB)
            end = 10;
    }
    if (n < end + 1)
        return more();
    if (p[end] != 0xBB)
        return reject(CANSER_REJECT_END);
    finding f = frame(end + 1, row, id, ext, rtr, dlc, p + 10);
    row->err = err;
    return f;
}

/* AA | 55 | command | ... 16 bytes ... | low byte of the sum of bytes 2 to 18 */
static finding look_seeed_fixed(const uint8_t *p, size_t n, canser_frame *row)
{
    if (n < 20)
        return more();
    unsigned sum = 0;
    for (int i = 2; i <= 18; i++)
        sum += p[i];
    if (p[19] != sum % 256)
        return reject(CANSER_REJECT_SUM);
    if (p[2] != 0x01)
        return control(20);
    if (p[3] != 1 && p[3] != 2)
        return reject(CANSER_REJECT_FIELD);
    if (p[4] != 1 && p[4] != 2)
        return reject(CANSER_REJECT_FIELD);
    bool ext = p[3] == 2;
    bool rtr = p[4] == 2;
    uint32_t id = little_endian(p + 5, 4);
    if (ext && id > 0x1FFFFFFF)
        return reject(CANSER_REJECT_FIELD);
    if (!ext && id > 0x7FF)
        return reject(CANSER_REJECT_FIELD);
    uint8_t dlc = p[9];
    if (dlc > 8)
        return reject(CANSER_REJECT_FIELD);
    return frame(20, row, id, ext, rtr, dlc, p + 10);
}

/* AA | 1 1 ext rtr dlc[3..0] | id, 2 or 4 | payload, dlc | 55 */
static finding look_seeed(const uint8_t *p, size_t n, canser_frame *row)
{
    if (p[0] != 0xAA)
        return reject(CANSER_REJECT_MARKER);
    if (n < 2)
        return more();
    if (p[1] == 0x55)
        return look_seeed_fixed(p, n, row);
    if ((p[1] & 0x80) == 0 || (p[1] & 0x40) == 0)
        return reject(CANSER_REJECT_TYPE);
    bool ext = (p[1] & 0x20) != 0;
    bool rtr = (p[1] & 0x10) != 0;
    uint8_t dlc = p[1] & 0x0F;
    if (dlc > 8)
        return reject(CANSER_REJECT_DLC);
    int id_len = ext ? 4 : 2;
    size_t behind_id = 2 + (size_t)id_len;
    if (n < behind_id)
        return more();
    uint32_t id = little_endian(p + 2, id_len);
    if (id > (ext ? 0x1FFFFFFFu : 0x7FFu))
        return reject(CANSER_REJECT_ID);
    size_t end = behind_id + dlc;
    if (rtr) {
        if (n < behind_id + 1)
            return more();
        if (p[behind_id] == 0x55)
            end = behind_id;
    }
    if (n < end + 1)
        return more();
    if (p[end] != 0x55)
        return reject(CANSER_REJECT_END);
    return frame(end + 1, row, id, ext, rtr, dlc, p + behind_id);
}

/* id[10..3] | id[2..0] rtr dlc[3..0] | payload, dlc     or     FF FF | command | ... */
static finding look_cantalope(const uint8_t *p, size_t n, canser_frame *row)
{
    if (n < 2)
        return more();
    if (p[0] == 0xFF && p[1] == 0xFF) {
        if (n < 3)
            return more();
        if (p[2] == 0x00)
            return control(3);
        if (p[2] == 0x01)
            return n < 4 ? more() : control(4);
        return reject(CANSER_REJECT_COMMAND);
    }
    uint32_t id = p[0] * 8u + p[1] / 32u;
    bool rtr = (p[1] & 0x10) != 0;
    uint8_t dlc = p[1] & 0x0F;
    if (dlc > 8)
        return reject(CANSER_REJECT_DLC);
    if (n < 2 + (size_t)dlc)
        return more();
    return frame(2 + (size_t)dlc, row, id, false, rtr, dlc, p + 2);
}

/* The time of the next frame, its counter being `raw`, in nanoseconds. Each step
 * is taken as a signed number of 32 bits; but if one of the next four frames
 * behind a clock that ran in line is near where it stood, then from there. */
static int64_t next_time(plain_stream *self, uint32_t raw)
{
    if (!self->started) {
        self->started = true;
        self->ticks = raw;
    } else {
        uint64_t before = self->ticks;
        uint32_t ahead = raw - self->raw; /* modulo 2^32 */

        /* A signed number of 32 bits: from half a turn on it is negative. */
        self->ticks += ahead < 0x80000000 ? ahead : ahead - UINT64_C(0x100000000);
        if (raw >= self->raw && ahead <= 0x1000000) {
            self->small_steps++;
            self->behind_line++;
        } else {
            bool in_line = self->near_line || self->small_steps >= 16;
            if (in_line) {
                self->has_line = true;
                self->line = before;
                self->behind_line = 0;
            }
            self->behind_line++;
            self->near_line = false;
            self->small_steps = 0;
            /* From 2^24 before the line to 2^24 behind it. */
            uint32_t from_line = raw - (uint32_t)self->line;
            bool reached = self->has_line && self->behind_line <= 4;
            if (reached && from_line <= 0x1000000) {
                self->ticks = self->line + from_line;
                self->near_line = true;
            } else if (reached && from_line >= 0xFF000000) {
                self->ticks = self->line - (0x100000000 - from_line);
                self->near_line = true;
            }
            /* Modulo 2^64, where times do not go half round. */
            if (self->ticks - before >= UINT64_C(1) << 63) {
                self->stats.ts_backsteps++;
                if (in_line && before - self->ticks > 0x1000000)
                    self->stats.ts_uncertain++;
            } else if (raw < self->raw) {
                self->stats.ts_wraps++;
            }
        }
    }
    self->raw = raw;

    uint64_t ns = self->ticks * (uint64_t)self->tick_ns;
    int64_t time;
    memcpy(&time, &ns, sizeof time);
    return time;
}

static size_t put_little_endian(uint8_t *out, uint32_t value, size_t byte_count)
{
    for (size_t i = 0; i < byte_count; i++) {
        out[i] = (uint8_t)(value % 256);
        value /= 256;
    }
    return byte_count;
}

/* The data of a frame, `len` bytes of it; zeros for a remote frame, which has none. */
static size_t put_data(uint8_t *out, const canser_frame *f, size_t len)
{
    for (size_t i = 0; i < len; i++)
        out[i] = f->rtr || i >= f->dlc ? 0 : f->data[i];
    return len;
}

static size_t encode_serial(const canser_frame *f, int64_t tick_ns, uint8_t *out)
{
    size_t len = 0;
    int64_t tick = f->ts / tick_ns;
    uint32_t word = f->id;

    if (f->ts % tick_ns < 0)
        tick--; /* C rounds to zero; a time goes out rounded down */
    if (f->ext)
        word |= 0x80000000;
    if (f->rtr)
        word |= 0x40000000;
    if (f->err)
        word |= 0x20000000;
    out[len++] = 0xAA;
    len += put_little_endian(out + len, (uint32_t)(uint64_t)tick, 4);
    out[len++] = f->dlc;
    len += put_little_endian(out + len, word, 4);
    if (!f->rtr)
        len += put_data(out + len, f, f->dlc);
    out[len++] = 0xBB;
    return len;
}

static size_t encode_seeed(const canser_frame *f, int64_t tick_ns, uint8_t *out)
{
    size_t len = 0;

    (void)tick_ns;
    out[len++] = 0xAA;
    out[len++] = (uint8_t)(0xC0 + (f->ext ? 0x20 : 0) + (f->rtr ? 0x10 : 0) + f->dlc);
    len += put_little_endian(out + len, f->id, f->ext ? 4 : 2);
    len += put_data(out + len, f, f->dlc);
    out[len++] = 0x55;
    return len;
}

static size_t encode_cantalope(const canser_frame *f, int64_t tick_ns, uint8_t *out)
{
    (void)tick_ns;
    out[0] = (uint8_t)(f->id / 8);
    out[1] = (uint8_t)(f->id % 8 * 32 + (f->rtr ? 0x10 : 0) + f->dlc);
    return 2 + put_data(out + 2, f, f->dlc);
}

/* The protocols: one row for each of the list in canser.h. */
typedef struct {
    plain_format format;
    finding (*look)(const uint8_t *p, size_t n, canser_frame *row);
    size_t (*encode)(const canser_frame *f, int64_t tick_ns, uint8_t *out);
} row_of_protocol;

static const row_of_protocol row_cantalope = {
    {.name = "cantalope", .baudrate = 115200, .alphabet = "\xFF\xFF\xFF\x01\x00\x08\x09\x12"},
    look_cantalope,
    encode_cantalope,
};

static const row_of_protocol row_seeed = {
    {.name = "seeed",
     .has_ext = true,
     .has_bitrates = true,
     .baudrate = 2000000,
     .alphabet = "\xAA\xAA\xAA\x55\x55\xC0\xE1\x01",
     .end = 0x55},
    look_seeed,
    encode_seeed,
};

static const row_of_protocol row_serial = {
    {.name = "serial",
     .has_clock = true,
     .has_ext = true,
     .has_err = true,
     .baudrate = 115200,
     .alphabet = "\xAA\xAA\xAA\xBB\xBB\x00\x01\x40",
     .end = 0xBB},
    look_serial,
    encode_serial,
};

#define ROW(name, packet_max) &row_##name,
static const row_of_protocol *const rows[] = {CANSER_PROTOCOLS(ROW)};
#undef ROW

const plain_format *plain_format_of(int protocol)
{
    return &rows[protocol]->format;
}

void plain_begin(plain_stream *self, int protocol, int64_t tick_ns)
{
    const plain_stream fresh = {
        .protocol = protocol,
        .tick_ns = tick_ns,
        .frames = self->frames,
        .offsets = self->offsets,
        .ends = self->ends,
        .controls = self->controls,
        .row_cap = self->row_cap,
    };
    *self = fresh;
}

void plain_scan(plain_stream *self, const uint8_t *bytes, size_t len, bool end)
{
    uint64_t base = self->stats.bytes_in;
    size_t pos = 0;

    while (pos < len) {
        const uint8_t *p = bytes + pos;
        canser_frame row;
        finding f = rows[self->protocol]->look(p, len - pos, &row);

        if (f.found == FOUND_MORE && !end)
            break;
        if (f.found == FOUND_MORE)
            f = reject(CANSER_REJECT_CUT);
        if (f.found == FOUND_REJECT) {
            self->stats.bytes_skipped++;
            self->stats.rejects[f.reason]++;
            if (!self->skipping)
                self->stats.resyncs++;
            self->skipping = true;
            pos++;
            continue;
        }
        self->skipping = false;
        if (f.found == FOUND_CONTROL) {
            if (self->control_count == self->row_cap)
                abort();
            canser_control *packet = &self->controls[self->control_count++];
            memset(packet, 0, sizeof *packet);
            packet->offset = base + pos;
            packet->len = (uint8_t)f.len;
            memcpy(packet->bytes, p, f.len);
            self->stats.controls++;
            self->stats.bytes_control += f.len;
        } else {
            if (self->frame_count == self->row_cap)
                abort();
            if (rows[self->protocol]->format.has_clock)
                row.ts = next_time(self, little_endian(p + 1, 4));
            self->offsets[self->frame_count] = (int64_t)(base + pos);
            self->ends[self->frame_count] = (int64_t)(base + pos + f.len);
            self->frames[self->frame_count++] = row;
            self->stats.frames++;
            self->stats.bytes_framed += f.len;
        }
        pos += f.len;
    }
    self->stats.bytes_in += len;
    self->pending = len - pos;
}

/* Why no frame of this kind goes out, or CANSER_REFUSAL_NONE. */
static int refuse(const plain_format *format, const canser_frame *f)
{
    if (f->dlc > 8)
        return CANSER_REFUSAL_DLC;
    if (f->id > 0x1FFFFFFF)
        return CANSER_REFUSAL_ID_EXT;
    if (!f->ext && f->id > 0x7FF)
        return CANSER_REFUSAL_ID;
    if (f->ext && !format->has_ext)
        return CANSER_REFUSAL_EXT;
    if (f->err && !format->has_err)
        return CANSER_REFUSAL_ERR;
    if (f->ts == CANSER_NO_TIME && format->has_clock)
        return CANSER_REFUSAL_TIME;
    return CANSER_REFUSAL_NONE;
}

size_t plain_encode(int protocol, int64_t tick_ns, const canser_frame *f,
                    uint8_t out[CANSER_PACKET_MAX], int *refusal)
{
    *refusal = refuse(plain_format_of(protocol), f);
    return *refusal == CANSER_REFUSAL_NONE ? rows[protocol]->encode(f, tick_ns, out) : 0;
}
