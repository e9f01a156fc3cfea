/* gvret: the table of SavvyCAN and of GVRET devices.
 *
 *     Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
 *     1767225600123456,00000123,true,Rx,0,3,01,02,03,
 *
 * The time is in microseconds. Files of old devices have no column Dir: the caller leaves "d" out
 * of `columns`. Digits are hexadecimal, with or without zeros before them. A LEN over 8 is CAN FD:
 * such lines are counted. There are no remote and no error frames.
 *
 * Source: SavvyCAN, framefileio.cpp. Unusual, and left to the caller: the header.
 */
#include "text.h"

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    uint8_t data[DLC_MAX] = {0};
    uint64_t us, bus, len;
    unsigned ext = 0;

    p = take_char(take_number(p, &us), ',');
    if (!p || us > INT64_MAX / 1000)
        return NULL;
    const uint64_t text = load_text(p);
    const unsigned digits = count_hex(text);
    if (!digits || p[digits] != ',')
        return NULL;
    p += digits + 1;
    /* Letters in any case. */
    const uint64_t word = load_text(p) | EACH(0x20);
    if ((word & UINT64_C(0xFFFFFFFF)) == UINT64_C(0x65757274)) { /* "true" */
        ext = 1;
        p += 4;
    } else if ((word & UINT64_C(0xFFFFFFFFFF)) == UINT64_C(0x65736C6166)) { /* "false" */
        p += 5;
    } else {
        return NULL;
    }
    if (self->columns[0] == 'd') {
        if (p[0] != ',' || p[2] != 'x' || (p[1] != 'R' && p[1] != 'T'))
            return NULL;
        row->direction = p[1] == 'T' ? CANSER_SENT : CANSER_RECEIVED;
        p += 3;
    }
    /* Mostly the bus and the dlc have one digit: then four characters are looked at together. */
    const uint32_t fields = load_le32(p);
    bus = fields >> 8 & 0xF, len = fields >> 24 & 0xF;
    if (CANSER_LIKELY((fields & 0xF0FFF0FF) == 0x302C302C && bus <= 9 && len <= DLC_MAX &&
                      p[4] == ',')) {
        p += 4;
    } else {
        p = take_number(take_char(take_number(take_char(p, ','), &bus), ','), &len);
        if (!p || bus >= CANSER_NO_CHANNEL)
            return NULL;
    }
    row->channel = (uint8_t)bus;
    if (len > DLC_MAX) {
        const uint8_t *const end = len <= 64 ? memchr(p, '\n', 256) : NULL;
        if (!end)
            return NULL;
        self->fd_count++;
        row->direction = SKIPPED;
        return end + 1;
    }
    p = take_gapped(p, (size_t)len, ',', data);
    if (!p)
        return NULL;
    for (int i = 0; i <= DLC_MAX && *p == ','; i++)
        p++;
    if (!put_frame(row->frame, (int64_t)us * 1000, hex_value(text, digits), ext, 0, 0, (size_t)len,
                   data))
        return NULL;
    return take_end(p);
}

CANSER_INLINE uint8_t *put_line(canser_text *self, const canser_frame *frame, unsigned channel,
                                unsigned direction, uint8_t *out)
{
    const bool known = frame->ts != CANSER_NO_TIME;
    const int64_t ts = known ? frame->ts : 0;
    uint32_t ns;

    self->unknown_times += !known;
    self->cut_times += ts % 1000 != 0;
    if (CANSER_LIKELY(ts >= 1000000000)) {
        out = put_seconds(self, out, ts, &ns) - 1; /* microseconds: without the point */
        out = put_six(out, ns / 1000);
    } else {
        if (ts < 0)
            *out++ = '-';
        out = put_number(out, (ts < 0 ? 0 - (uint64_t)ts : (uint64_t)ts) / 1000);
    }
    *out++ = ',';
    store_text(out, hex_text(split_hex(frame->id), 'A'));
    out += 8;
    out = frame->ext ? PUT(out, ",true,") : PUT(out, ",false,");
    out = direction == CANSER_SENT ? PUT(out, "Tx,") : PUT(out, "Rx,");
    out = put_number(out, channel == CANSER_NO_CHANNEL ? 0 : channel);
    *out++ = ',';
    *out++ = (uint8_t)('0' + frame->dlc);
    out = put_spaced(out, frame->data, frame->dlc, ',');
    *out++ = ',';
    *out++ = '\n';
    return out;
}

static uint8_t *write(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    return write_lines(self, from, out, out_cap, result, put_line);
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_gvret = {"gvret", &codec};
