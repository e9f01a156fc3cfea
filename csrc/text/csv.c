/* csv: the table that python-can's CSVWriter writes.
 *
 *     timestamp,arbitration_id,extended,remote,error,dlc,data
 *     1631416514.717133,0xd2,0,0,0,8,AAD//xAAAAA=
 *
 * Source: python-can, can.io.csv. A dlc over 8 is the only mark of CAN FD: such lines are counted.
 * Unusual, and left to the caller: the header, columns in another order, quoted fields, times that
 * are no plain number.
 */
#include "text.h"

/* The six bits of a character of base64, plus 1; 0 for all others. */
#define L(at, value) [at] = value + 1
static const uint8_t bits_of[256] = {
    L('A', 0),  L('B', 1),  L('C', 2),  L('D', 3),  L('E', 4),  L('F', 5),  L('G', 6),  L('H', 7),
    L('I', 8),  L('J', 9),  L('K', 10), L('L', 11), L('M', 12), L('N', 13), L('O', 14), L('P', 15),
    L('Q', 16), L('R', 17), L('S', 18), L('T', 19), L('U', 20), L('V', 21), L('W', 22), L('X', 23),
    L('Y', 24), L('Z', 25), L('a', 26), L('b', 27), L('c', 28), L('d', 29), L('e', 30), L('f', 31),
    L('g', 32), L('h', 33), L('i', 34), L('j', 35), L('k', 36), L('l', 37), L('m', 38), L('n', 39),
    L('o', 40), L('p', 41), L('q', 42), L('r', 43), L('s', 44), L('t', 45), L('u', 46), L('v', 47),
    L('w', 48), L('x', 49), L('y', 50), L('z', 51), L('0', 52), L('1', 53), L('2', 54), L('3', 55),
    L('4', 56), L('5', 57), L('6', 58), L('7', 59), L('8', 60), L('9', 61), L('+', 62), L('/', 63),
};
#undef L
static const char characters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/* `count` bytes in base64, padded. */
CANSER_INLINE const uint8_t *take_base64(const uint8_t *p, size_t count, uint8_t *data)
{
    for (size_t at = 0; at < count; at += 3, p += 4) {
        const size_t bytes = count - at < 3 ? count - at : 3;
        uint32_t bits = 0;

        for (size_t i = 0; i < 4; i++) {
            const unsigned six = bits_of[p[i]];
            if (i <= bytes ? !six : p[i] != '=')
                return NULL;
            bits = bits << 6 | ((six - 1) & (i <= bytes ? 63u : 0u));
        }
        /* Bits behind the last byte must be zero: else two texts would mean the same. */
        if (bits & (UINT32_C(0xFFFFFF) >> 8 * bytes))
            return NULL;
        for (size_t i = 0; i < 3; i++)
            data[at + i] = (uint8_t)(bits >> (16 - 8 * i));
    }
    return p;
}

/* A comma, and a flag. */
CANSER_INLINE const uint8_t *take_flag(const uint8_t *p, unsigned *flag)
{
    if (!p || p[0] != ',' || (p[1] & 0xFE) != '0')
        return NULL;
    *flag = p[1] - '0';
    return p + 2;
}

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    uint8_t data[DLC_MAX + 1] = {0};
    unsigned ext, rtr, err;
    uint64_t dlc;
    int64_t ts;

    p = take_fixed(p, 9, &ts);
    if (!p || p[0] != ',' || p[1] != '0' || p[2] != 'x')
        return NULL;
    const uint64_t text = load_text(p += 3);
    const unsigned digits = count_hex(text);
    if (!digits)
        return NULL;
    p = take_flag(take_flag(take_flag(p + digits, &ext), &rtr), &err);
    p = take_char(take_number(take_char(p, ','), &dlc), ',');
    if (!p)
        return NULL;
    if (dlc > DLC_MAX && dlc <= 64) {
        const uint8_t *const end = memchr(p, '\n', 128);
        if (!end)
            return NULL;
        self->fd_count++;
        row->direction = SKIPPED;
        return end + 1;
    }
    if (!put_frame(row->frame, ts, hex_value(text, digits), ext, rtr, err, (size_t)dlc, data))
        return NULL;
    if (!rtr) {
        p = take_base64(p, (size_t)dlc, data);
        memcpy(row->frame->data, data, DLC_MAX);
    }
    return take_end(p);
}

CANSER_INLINE uint8_t *put_base64(uint8_t *out, const uint8_t *data, size_t count)
{
    for (size_t at = 0; at < count; at += 3, out += 4) {
        const uint32_t bits = (uint32_t)data[at] << 16 |
                              (uint32_t)(at + 1 < DLC_MAX ? data[at + 1] : 0) << 8 |
                              (at + 2 < DLC_MAX ? data[at + 2] : 0);
        for (int i = 0; i < 4; i++)
            out[i] = (uint8_t)characters[bits >> (18 - 6 * i) & 63];
        if (count - at < 3)
            out[3] = '=';
        if (count - at < 2)
            out[2] = '=';
    }
    return out;
}

static uint8_t *write(canser_text *self, const canser_frame *frame, unsigned channel,
                      unsigned direction, uint8_t *out)
{
    static const char lower[] = "0123456789abcdef";
    uint8_t data[DLC_MAX] = {0};
    uint32_t ns;
    int shift = 28;

    (void)channel, (void)direction;
    if (frame->ts == CANSER_NO_TIME) {
        out = PUT(out, "nan");
    } else {
        out = put_seconds(self, out, frame->ts, &ns);
        out = put_digits(out, ns / 1000, 6);
        if (ns % 1000) {
            *out++ = (uint8_t)('0' + ns / 100 % 10);
            out = put_digits(out, ns % 100, 2);
        }
    }
    out = PUT(out, ",0x");
    while (shift && !(frame->id >> shift))
        shift -= 4;
    for (; shift >= 0; shift -= 4)
        *out++ = (uint8_t)lower[frame->id >> shift & 15];
    const uint8_t fields[] = {
        ',', (uint8_t)('0' + !!frame->ext), ',', (uint8_t)('0' + !!frame->rtr),
        ',', (uint8_t)('0' + !!frame->err), ',', (uint8_t)('0' + frame->dlc)};
    memcpy(out, fields, sizeof fields);
    out += sizeof fields;
    *out++ = ',';
    memcpy(data, frame->data, data_len(frame));
    out = put_base64(out, data, data_len(frame));
    *out++ = '\n';
    return out;
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_csv = {"csv", &codec};
