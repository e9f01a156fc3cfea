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

/* The six bits of a character of base64; OTHER for all others. */
enum { OTHER = 0x80 };
#define A_TO_Z(first)                                                                              \
    first, first + 1, first + 2, first + 3, first + 4, first + 5, first + 6, first + 7, first + 8, \
        first + 9, first + 10, first + 11, first + 12, first + 13, first + 14, first + 15,         \
        first + 16, first + 17, first + 18, first + 19, first + 20, first + 21, first + 22,        \
        first + 23, first + 24, first + 25
#define NO_8  OTHER, OTHER, OTHER, OTHER, OTHER, OTHER, OTHER, OTHER
#define NO_32 NO_8, NO_8, NO_8, NO_8
static const uint8_t bits_of[256] = {
    NO_32,      NO_8,  OTHER, OTHER, OTHER, 62,        OTHER, OTHER, OTHER, 63, /* + / */
    52,         53,    54,    55,    56,    57,        58,    59,    60,    61,    OTHER, OTHER,
    OTHER,      OTHER, OTHER, OTHER, OTHER, A_TO_Z(0), OTHER, OTHER, OTHER, OTHER, OTHER, OTHER,
    A_TO_Z(26), OTHER, OTHER, OTHER, OTHER, OTHER,     NO_32, NO_32, NO_32, NO_32,
};

/* Two characters of base64 for each number of 12 bits. */
#define WITH(c)                                                                                    \
    c, 'A', c, 'B', c, 'C', c, 'D', c, 'E', c, 'F', c, 'G', c, 'H', c, 'I', c, 'J', c, 'K', c,     \
        'L', c, 'M', c, 'N', c, 'O', c, 'P', c, 'Q', c, 'R', c, 'S', c, 'T', c, 'U', c, 'V', c,    \
        'W', c, 'X', c, 'Y', c, 'Z', c, 'a', c, 'b', c, 'c', c, 'd', c, 'e', c, 'f', c, 'g', c,    \
        'h', c, 'i', c, 'j', c, 'k', c, 'l', c, 'm', c, 'n', c, 'o', c, 'p', c, 'q', c, 'r', c,    \
        's', c, 't', c, 'u', c, 'v', c, 'w', c, 'x', c, 'y', c, 'z', c, '0', c, '1', c, '2', c,    \
        '3', c, '4', c, '5', c, '6', c, '7', c, '8', c, '9', c, '+', c, '/'
static const uint8_t pairs[8192] = {
    WITH('A'), WITH('B'), WITH('C'), WITH('D'), WITH('E'), WITH('F'), WITH('G'), WITH('H'),
    WITH('I'), WITH('J'), WITH('K'), WITH('L'), WITH('M'), WITH('N'), WITH('O'), WITH('P'),
    WITH('Q'), WITH('R'), WITH('S'), WITH('T'), WITH('U'), WITH('V'), WITH('W'), WITH('X'),
    WITH('Y'), WITH('Z'), WITH('a'), WITH('b'), WITH('c'), WITH('d'), WITH('e'), WITH('f'),
    WITH('g'), WITH('h'), WITH('i'), WITH('j'), WITH('k'), WITH('l'), WITH('m'), WITH('n'),
    WITH('o'), WITH('p'), WITH('q'), WITH('r'), WITH('s'), WITH('t'), WITH('u'), WITH('v'),
    WITH('w'), WITH('x'), WITH('y'), WITH('z'), WITH('0'), WITH('1'), WITH('2'), WITH('3'),
    WITH('4'), WITH('5'), WITH('6'), WITH('7'), WITH('8'), WITH('9'), WITH('+'), WITH('/')};

/* Three bytes, or the `count` first of them, in four characters of base64, padded. */
CANSER_INLINE const uint8_t *take_quad(const uint8_t *p, size_t count, uint8_t *data)
{
    const unsigned a = bits_of[p[0]], b = bits_of[p[1]], c = count > 1 ? bits_of[p[2]] : 0,
                   d = count > 2 ? bits_of[p[3]] : 0;
    const uint32_t bits = a << 18 | b << 12 | c << 6 | d;

    if ((a | b | c | d) & OTHER || (count < 2 && p[2] != '=') || (count < 3 && p[3] != '='))
        return NULL;
    /* Bits behind the last byte must be zero: else two texts would mean the same. */
    if (bits & (UINT32_C(0xFFFFFF) >> 8 * count))
        return NULL;
    data[0] = (uint8_t)(bits >> 16);
    data[1] = (uint8_t)(bits >> 8);
    data[2] = (uint8_t)bits;
    return p + 4;
}

/* `count` bytes in base64. */
CANSER_INLINE const uint8_t *take_base64(const uint8_t *p, size_t count, uint8_t *data)
{
    size_t at = 0;

    for (; p && at + 3 <= count; at += 3)
        p = take_quad(p, 3, data + at);
    return p && at < count ? take_quad(p, count - at, data + at) : p;
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

    p = take_seconds(self, p, &ts);
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

/* All eight bytes are written, without a branch, and `count` of them kept. */
CANSER_INLINE uint8_t *put_base64(uint8_t *out, const uint8_t *data, size_t count)
{
    uint64_t bits = 0;

    for (int i = 0; i < DLC_MAX; i++)
        bits = bits << 8 | data[i];
    for (int i = 0; i < 5; i++)
        memcpy(out + 2 * i, pairs + 2 * (bits >> (52 - 12 * i) & 4095), 2);
    memcpy(out + 10, pairs + 2 * (bits << 8 & 4095), 2);
    out[11] = '=';
    /* A character for six bits that were begun; then four are made whole. */
    memset(out + (8 * count + 5) / 6, '=', 2);
    return out + (count + 2) / 3 * 4;
}

CANSER_INLINE uint8_t *put_line(canser_text *self, const canser_frame *frame, unsigned channel,
                                unsigned direction, uint8_t *out)
{
    uint8_t data[DLC_MAX];
    uint32_t ns;

    (void)channel, (void)direction;
    if (frame->ts == CANSER_NO_TIME) {
        out = PUT(out, "nan");
    } else {
        out = put_seconds(self, out, frame->ts, &ns);
        out = put_six(out, ns / 1000);
        if (ns % 1000) {
            *out++ = (uint8_t)('0' + ns / 100 % 10);
            out = put_digits(out, ns % 100, 2);
        }
    }
    out = PUT(out, ",0x");
    const uint64_t digits = split_hex(frame->id);
    const unsigned zeros = count_zeros(digits);
    store_text(out, hex_text(digits, 'a') >> 8 * zeros);
    out += 8 - zeros;
    const uint8_t fields[] = {
        ',', (uint8_t)('0' + !!frame->ext), ',', (uint8_t)('0' + !!frame->rtr),
        ',', (uint8_t)('0' + !!frame->err), ',', (uint8_t)('0' + frame->dlc)};
    memcpy(out, fields, sizeof fields);
    out += sizeof fields;
    *out++ = ',';
    const uint64_t payload = load_payload(frame->data, data_len(frame));
    memcpy(data, &payload, sizeof data);
    out = put_base64(out, data, data_len(frame));
    *out++ = '\n';
    return out;
}

static uint8_t *write(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    return write_lines(self, from, out, out_cap, result, put_line);
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_csv = {"csv", &codec};
