/* asc: the log of Vector's CANalyzer and CANoe.
 *
 *        0.001000 1  123x            Rx   d 8 01 02 03 04 05 06 07 08
 *        0.002000 2  7FF             Tx   r 8
 *        0.003000 1  ErrorFrame
 *
 * Time in seconds, channel from 1, id (extended with an x), direction, data or remote, dlc, bytes.
 * With `is_relative` a time counts from the line before. Behind the bytes there may be
 * "Length = ... BitCount = ...".
 *
 * Source: files of Vector's programs; python-can, can.io.asc. Unusual, and left to the caller: the
 * header, decimal ids and bytes, CAN FD, error frames, lines of other events, dlcs over 8.
 */
#include "text.h"

/* What may follow a frame: blanks, and the length of the frame on the bus. */
CANSER_INLINE const uint8_t *take_rest(const uint8_t *p, const uint8_t *line)
{
    if (!p)
        return NULL;
    if (*p == '\n')
        return p + 1;
    p = skip_blanks(p);
    return p && p[0] == 'L' && p[1] == 'e' ? skip_line(p, line) : take_end(p);
}

/* What follows the time of a data frame, if each column has its usual width, as Vector's programs
 * and canser write it: " 1  123x            Rx   d 8"; NULL for any other one. Where a column lies
 * depends on no column before it, so none waits for another. */
CANSER_INLINE const uint8_t *take_usual(const uint8_t *p, text_row *row, uint32_t *id,
                                        unsigned *ext, unsigned *dlc)
{
    enum { ID = 4, KIND = 20, DATA = 28 };
    const uint64_t head = load_text(p), text = load_text(p + ID), behind = load_text(p + ID + 8),
                   kind = load_text(p + KIND);
    const unsigned digits = count_hex(text), channel = (unsigned)(head >> 8 & 0xFF) - '1',
                   sent = (kind & 0xFF) == 'T';

    *ext = p[ID + digits] == 'x';
    *dlc = (unsigned)(kind >> 56) - '0';
    /* The characters of the id, up to nine, are taken out of its column of 16. */
    const unsigned len = digits + *ext;
    const uint64_t blanks = len < 8 ? UINT64_MAX << 8 * len : 0,
                   more = len > 8 ? UINT64_MAX << 8 : UINT64_MAX;
    if (!digits || (head & UINT64_C(0xFFFF00FF)) != UINT64_C(0x20200020) || channel > 8 ||
        ((text ^ EACH(' ')) & blanks) || ((behind ^ EACH(' ')) & more) ||
        (kind & UINT64_C(0x00FFFFFFFFFFFF00)) != UINT64_C(0x0020642020207800) ||
        (!sent && (kind & 0xFF) != 'R') || *dlc > DLC_MAX)
        return NULL;
    row->channel = (uint8_t)channel;
    row->direction = sent ? CANSER_SENT : CANSER_RECEIVED;
    *id = hex_value(text, digits);
    return p + DATA;
}

/* What follows the time of a data or a remote frame, up to its dlc. */
CANSER_INLINE const uint8_t *take_tokens(const uint8_t *p, text_row *row, uint32_t *id,
                                         unsigned *ext, unsigned *rtr, unsigned *dlc)
{
    uint64_t channel;

    p = take_blanks(take_number(take_blanks(p), &channel));
    if (!p || channel == 0 || channel > CANSER_NO_CHANNEL)
        return NULL;
    row->channel = (uint8_t)(channel - 1);
    const uint64_t text = load_text(p);
    const unsigned digits = count_hex(text);
    if (!digits)
        return NULL;
    p += digits;
    *ext = *p == 'x';
    p = take_blanks(p + *ext);
    if (!p || p[1] != 'x' || (p[0] != 'R' && p[0] != 'T'))
        return NULL;
    row->direction = *p == 'T' ? CANSER_SENT : CANSER_RECEIVED;
    p += 2;
    if (p[0] == 'R' && p[1] == 'q')
        p += 2;
    p = take_blanks(p);
    if (!p || (*p != 'd' && *p != 'r'))
        return NULL;
    *rtr = *p == 'r';
    p = take_blanks(p + 1);
    if (!p)
        return NULL;
    *dlc = (unsigned)(*p - '0');
    if (*dlc > DLC_MAX)
        return NULL;
    *id = hex_value(text, digits);
    return p + 1;
}

/* A time, and keep the text of its second, if it has six places. */
CANSER_COLD const uint8_t *take_any_time(canser_text *self, const uint8_t *p, int64_t *ts)
{
    const uint8_t *const begin = skip_blanks(p), *const end = take_fixed(begin, 9, ts);

    self->seconds_low = 0;
    if (end && end - begin > 7 && end[-7] == '.' && *begin != '-' && end - 6 - p <= 8) {
        self->seconds_low = (uint32_t)(end - 6 - p);
        self->seconds_high = load_text(p) & UINT64_MAX >> (64 - 8 * self->seconds_low);
        self->seconds_ns = *ts - *ts % 1000000000;
    }
    return end;
}

/* A time, with the blanks before it. Most lines have the second of the line before. */
CANSER_INLINE const uint8_t *take_time(canser_text *self, const uint8_t *p, int64_t *ts)
{
    const unsigned len = self->seconds_low; /* of the blanks, the second and the point */
    const uint64_t places = load_text(p + len);

    if (CANSER_LIKELY(len && !((load_text(p) ^ self->seconds_high) << (64 - 8 * len)) &&
                      count_digits(places) == 6)) {
        *ts = self->seconds_ns + (int64_t)digits_value(places, 6) * 1000;
        return p + len + 6;
    }
    return take_any_time(self, p, ts);
}

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    const uint8_t *const line = p;
    uint8_t data[DLC_MAX] = {0};
    uint32_t id = 0;
    unsigned ext = 0, rtr = 0, dlc = 0;
    int64_t ts;

    if (self->is_decimal)
        return NULL;
    p = take_time(self, p, &ts);
    if (!p)
        return NULL;
    const uint8_t *const usual = take_usual(p, row, &id, &ext, &dlc);
    p = CANSER_LIKELY(usual) ? usual : take_tokens(p, row, &id, &ext, &rtr, &dlc);
    if (!rtr)
        p = take_spaced(p, dlc, data);
    p = take_rest(p, line);
    if (!p || !put_frame(row->frame, ts, id, ext, rtr, 0, dlc, data))
        return NULL;
    if (self->is_relative) {
        const int64_t last = self->last_ns;
        if (ts > 0 ? last > INT64_MAX - ts : last <= INT64_MIN - ts)
            return NULL;
        row->frame->ts = self->last_ns = last + ts;
    }
    return p;
}

/* Blanks that fill a column of 16 characters, which begins at `begin`. */
CANSER_INLINE uint8_t *pad_to_16(uint8_t *out, const uint8_t *begin)
{
    memset(out, ' ', 16);
    return out + 16 - (out - begin);
}

CANSER_INLINE uint8_t *put_line(canser_text *self, const canser_frame *frame, unsigned channel,
                                unsigned direction, uint8_t *out)
{
    const bool known = frame->ts != CANSER_NO_TIME;
    uint32_t ns;

    *out++ = ' ';
    out = put_seconds(self, out,
                      known ? (int64_t)((uint64_t)frame->ts - (uint64_t)self->start_ns) : 0, &ns);
    self->unknown_times += !known;
    self->cut_times += ns % 1000 != 0;
    out = put_six(out, ns / 1000);
    *out++ = ' ';
    out = put_number(out, channel == CANSER_NO_CHANNEL ? 1 : channel + 1);
    out = PUT(out, "  ");
    if (frame->err) {
        self->error_frames++;
        return PUT(out, "ErrorFrame\n");
    }
    uint8_t *const id = out;
    const uint64_t digits = split_hex(frame->id);
    const unsigned zeros = count_zeros(digits);
    store_text(out, hex_text(digits, 'A') >> 8 * zeros);
    out += 8 - zeros;
    *out = 'x';
    out = pad_to_16(out + !!frame->ext, id);
    out = direction == CANSER_SENT ? PUT(out, "Tx   ") : PUT(out, "Rx   ");
    *out++ = frame->rtr ? 'r' : 'd';
    *out++ = ' ';
    *out++ = (uint8_t)('0' + frame->dlc);
    out = put_spaced(out, frame->data, data_len(frame), ' ');
    *out++ = '\n';
    return out;
}

static uint8_t *write(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    return write_lines(self, from, out, out_cap, result, put_line);
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_asc = {"asc", &codec};
