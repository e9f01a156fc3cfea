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

/* The six bits of each character of base64, at their place in 24 bits; OTHER for all others. */
#define OTHER     UINT32_C(0x80000000)
#define SIX(n, s) (UINT32_C(n) << s)
#define FIVE(n, s)                                                                                 \
    SIX(n, s), SIX(n, s) + SIX(1, s), SIX(n, s) + SIX(2, s), SIX(n, s) + SIX(3, s),                \
        SIX(n, s) + SIX(4, s)
#define NO_5   OTHER, OTHER, OTHER, OTHER, OTHER
#define NO_43  NO_5, NO_5, NO_5, NO_5, NO_5, NO_5, NO_5, NO_5, OTHER, OTHER, OTHER
#define NO_133 NO_43, NO_43, NO_43, OTHER, OTHER, OTHER, OTHER
#define BASE64(s)                                                                                  \
    {NO_43,       SIX(62, s),  OTHER,       OTHER,      OTHER,      SIX(63, s),  FIVE(52, s),      \
     FIVE(57, s), NO_5,        OTHER,       OTHER,      FIVE(0, s), FIVE(5, s),  FIVE(10, s),      \
     FIVE(15, s), FIVE(20, s), SIX(25, s),  NO_5,       OTHER,      FIVE(26, s), FIVE(31, s),      \
     FIVE(36, s), FIVE(41, s), FIVE(46, s), SIX(51, s), NO_133}
static const uint32_t bits_of[4][256] = {BASE64(18), BASE64(12), BASE64(6), BASE64(0)};

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

/* Three bytes, or the `count` first of them, in four characters of base64, padded: put behind the
 * lowest bit of `bytes`. */
CANSER_INLINE const uint8_t *take_quad(const uint8_t *p, size_t count, uint64_t *bytes)
{
    const uint32_t bits = bits_of[0][p[0]] | bits_of[1][p[1]] | (count > 1 ? bits_of[2][p[2]] : 0) |
                          (count > 2 ? bits_of[3][p[3]] : 0);

    if (bits & OTHER || (count < 2 && p[2] != '=') || (count < 3 && p[3] != '='))
        return NULL;
    /* Bits behind the last byte must be zero: else two texts would mean the same. */
    if (bits & (UINT32_C(0xFFFFFF) >> 8 * count))
        return NULL;
    *bytes = *bytes << 8 * count | bits >> (24 - 8 * count);
    return p + 4;
}

/* `count` bytes in base64, up to eight, zeros behind them. They are joined in a register: bytes
 * that were stored one by one would be waited for when all are loaded. */
CANSER_INLINE const uint8_t *take_base64(const uint8_t *p, size_t count, uint8_t *data)
{
    uint64_t bytes = 0;
    size_t at = 0;

    for (; p && at + 3 <= count; at += 3)
        p = take_quad(p, 3, &bytes);
    if (p && at < count)
        p = take_quad(p, count - at, &bytes);
    if (p && count) {
        bytes <<= 64 - 8 * count;
        store_le32(data, swap_bytes((uint32_t)(bytes >> 32)));
        store_le32(data + 4, swap_bytes((uint32_t)bytes));
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

/* Three flags and a digit, each behind a comma, as eight characters: without the bits that tell
 * flags and digits. */
#define FIELDS      UINT64_C(0x302C302C302C302C)
#define FIELDS_MASK UINT64_C(0xF0FFFEFFFEFFFEFF)

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    static const uint8_t none[DLC_MAX] = {0};
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
    p += digits;
    /* Mostly the dlc has one digit: then eight characters are looked at together. */
    const uint64_t fields = load_text(p);
    dlc = fields >> 56 & 0xF;
    if (CANSER_LIKELY(!((fields ^ FIELDS) & FIELDS_MASK) && dlc <= DLC_MAX && p[8] == ',')) {
        ext = fields >> 8 & 1, rtr = fields >> 24 & 1, err = fields >> 40 & 1;
        p += 9;
    } else {
        p = take_flag(take_flag(take_flag(p, &ext), &rtr), &err);
        p = take_char(take_number(take_char(p, ','), &dlc), ',');
        if (!p)
            return NULL;
    }
    if (dlc > DLC_MAX && dlc <= 64) {
        const uint8_t *const end = memchr(p, '\n', 128);
        if (!end)
            return NULL;
        self->fd_count++;
        row->direction = SKIPPED;
        return end + 1;
    }
    if (!put_frame(row->frame, ts, hex_value(text, digits), ext, rtr, err, (size_t)dlc, none))
        return NULL;
    if (!rtr)
        p = take_base64(p, (size_t)dlc, row->frame->data);
    return take_end(p);
}

/* Two characters of base64, for the 12 bits from a place on. */
CANSER_INLINE void put_pair(uint8_t *out, uint64_t bits, unsigned place)
{
    memcpy(out, pairs + 2 * (bits >> place & 4095), 2);
}

/* All eight bytes are written, without a branch, and `count` of them kept. */
CANSER_INLINE uint8_t *put_base64(uint8_t *out, const uint8_t *data, size_t count)
{
    const uint64_t bits =
        (uint64_t)swap_bytes(load_le32(data)) << 32 | swap_bytes(load_le32(data + 4));

    put_pair(out, bits, 52);
    put_pair(out + 2, bits, 40);
    put_pair(out + 4, bits, 28);
    put_pair(out + 6, bits, 16);
    put_pair(out + 8, bits, 4);
    put_pair(out + 10, bits << 8, 0);
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
