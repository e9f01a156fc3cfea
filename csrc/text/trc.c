/* trc: the trace of PEAK's PCAN programs, versions 1.0 to 2.1.
 *
 *     ;$FILEVERSION=2.1
 *     ;$COLUMNS=N,O,T,B,I,d,R,L,D
 *           1         0.500 DT 1     0123 Rx -  8    01 02 03 04 05 06 07 08
 *           2         1.000 RR 2 18FEF100 Tx -  4
 *
 * `columns` are the letters of $COLUMNS, in their order: N number, O time in milliseconds, T type,
 * B bus from 1, I id, d direction, R reserved, L dlc or l length, D data. Versions 1.x have no such
 * line; the caller gives N, O, t (Rx or Tx), B, I, R, L, D as the version has them. An id of four
 * digits is standard, a longer one extended.
 *
 * Source: PEAK-System, "PCAN trace file format". Unusual, and left to the caller: comments, error
 * frames, CAN FD, lines of other events.
 */
#include "text.h"

/* Rx or Tx. */
CANSER_INLINE const uint8_t *take_direction(const uint8_t *p, uint8_t *direction)
{
    if (p[1] != 'x' || (p[0] != 'R' && p[0] != 'T'))
        return NULL;
    *direction = p[0] == 'T' ? CANSER_SENT : CANSER_RECEIVED;
    return p + 2;
}

/* Whether eight characters are a number behind spaces, up to `spaces_most`. `no_digit` has the top
 * bit of each character that is no digit. */
CANSER_INLINE bool is_at_right(uint64_t text, uint64_t no_digit, unsigned spaces_most)
{
    const unsigned spaces = count_spaces(text);
    return spaces <= spaces_most && !(no_digit & UINT64_MAX << 8 * spaces);
}

/* Read a line of which each column has its usual width, as PCAN-View and canser write it; NULL for
 * any other one. Where a column lies depends on no column before it, so none waits for another. */
CANSER_INLINE const uint8_t *read_usual(const uint8_t *p, text_row *row)
{
    enum { DOT = 17, KIND = 21, ID = 27, DIRECTION = 35, DATA = 43 };
    const uint64_t number = load_text(p) << 8 | ' ', whole = load_text(p + DOT - 8),
                   places = load_text(p + DOT), kind = load_text(p + KIND), id = load_text(p + ID),
                   rest = load_text(p + DIRECTION);
    const unsigned bus = (unsigned)(kind >> 32 & 0xFF) - '0', sent = (rest >> 8 & 0xFF) == 'T',
                   dlc = (unsigned)(rest >> 56) - '0', spaces = count_spaces(id);
    uint8_t data[DLC_MAX] = {0};

    if (!is_at_right(number, find_no_digit(number), 7) || p[7] != ' ' || p[8] != ' ' ||
        !is_at_right(whole, find_no_digit(whole), 7) || !is_at_right(id, find_no_hex(id), 4))
        return NULL;
    /* ".ddd", " DT b ", and " Rx -  " or " Tx -  ". */
    if ((places & 0xFF) != '.' || count_digits(places >> 8) != 3 ||
        (kind & UINT64_C(0xFF00FFFFFFFF)) != UINT64_C(0x200020544420) || bus - 1 > 8 ||
        (rest & UINT64_C(0xFFFFFFFFFF00FF)) != UINT64_C(0x20202D20780020) ||
        (!sent && (rest >> 8 & 0xFF) != 'R') || dlc > DLC_MAX)
        return NULL;
    p = take_end(take_spaced(p + DATA, dlc, data));
    if (!p)
        return NULL;
    row->channel = (uint8_t)(bus - 1);
    row->direction = sent ? CANSER_SENT : CANSER_RECEIVED;
    /* Spaces are zeros to digits_value() and hex_value(). */
    const int64_t us = (int64_t)digits_value(whole, 8) * 1000 + digits_value(places >> 8, 3);
    return put_frame(row->frame, us * 1000, hex_value(id, 8), spaces < 4, 0, 0, dlc, data) ? p
                                                                                           : NULL;
}

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    if (!memcmp(self->columns, "NOTBIdRLD", 10)) {
        const uint8_t *const end = read_usual(p, row);
        if (CANSER_LIKELY(end))
            return end;
    }
    uint8_t data[DLC_MAX] = {0};
    uint64_t number, dlc = 0;
    uint32_t id = 0;
    unsigned ext = 0, rtr = 0;
    int64_t ts = 0;

    row->channel = 0; /* traces without a column for the bus are of one bus */
    for (const char *column = self->columns; *column; column++) {
        if (*column == 'D') {
            if (dlc > DLC_MAX)
                return NULL;
            const uint8_t *const begin = skip_blanks(p);
            if (begin && begin[0] == 'R' && begin[1] == 'T' && begin[2] == 'R') {
                rtr = 1;
                p = begin + 3;
            } else if (!rtr) {
                p = take_spaced(p, (size_t)dlc, data);
            }
            break;
        }
        p = column == self->columns ? skip_blanks(p) : take_blanks(p);
        if (!p)
            return NULL;
        switch (*column) {
        case 'N':
            p = take_number(p, &number);
            if (p && *p == ')')
                p++;
            break;
        case 'O':
            p = take_fixed(p, 6, &ts);
            break;
        case 'T':
            rtr = p[0] == 'R' && p[1] == 'R';
            p = rtr || (p[0] == 'D' && p[1] == 'T') ? p + 2 : NULL;
            break;
        case 't':
        case 'd':
            p = take_direction(p, &row->direction);
            break;
        case 'B':
            p = take_number(p, &number);
            if (!p || number == 0 || number > CANSER_NO_CHANNEL)
                return NULL;
            row->channel = (uint8_t)(number - 1);
            break;
        case 'I': {
            const uint64_t text = load_text(p);
            const unsigned digits = count_hex(text);
            if (digits < 4)
                return NULL;
            ext = digits > 4;
            id = hex_value(text, digits);
            p += digits;
            break;
        }
        case 'L':
        case 'l':
            p = take_number(p, &dlc);
            break;
        case 'R':
            p = take_char(p, '-');
            break;
        default:
            return NULL;
        }
        if (!p)
            return NULL;
    }
    p = take_end(p);
    return p && put_frame(row->frame, ts, id, ext, rtr, 0, (size_t)dlc, data) ? p : NULL;
}

/* A number at the right of a column of 7 to 9 characters; a longer one makes it wider. */
CANSER_INLINE uint8_t *put_right(uint8_t *out, uint64_t value, unsigned width)
{
    if (value >= tens[width < 8 ? width : 8])
        return put_number(out, value);
    const uint64_t digits = split_digits((uint32_t)value), blanks = '0' ^ ' ';
    const uint64_t text =
        (digits | EACH('0')) ^ (EACH(blanks) & ~(UINT64_MAX << 8 * count_zeros(digits)));
    *out = ' ';
    if (width < 8)
        store_text(out, text >> 8 * (8 - width));
    else
        store_text(out + width - 8, text);
    return out + width;
}

/* The number of the line, in 7 characters or more. Mostly only its last digit changes. */
CANSER_INLINE uint8_t *put_number_of_line(canser_text *self, uint8_t *out)
{
    const uint64_t last = UINT64_C(1) << 48;

    if (CANSER_LIKELY(++self->number % 10 && self->number_text && self->number < tens[7])) {
        self->number_text += last;
        store_text(out, self->number_text);
        return out + 7;
    }
    uint8_t *const end = put_right(out, self->number, 7);
    self->number_text = load_text(out);
    return end;
}

/* Keep the text of a second above 0, in 6 characters, with 3 digits behind it to come. */
CANSER_COLD void set_second(canser_text *self, uint64_t second)
{
    self->has_second = second > 0 && second < tens[6];
    self->second = second;
    if (self->has_second) {
        put_right(self->second_text, second, 7);
        memmove(self->second_text, self->second_text + 1, 6);
    }
}

/* Milliseconds, in 9 characters or more. */
CANSER_INLINE uint8_t *put_milliseconds(canser_text *self, uint8_t *out, uint64_t ms)
{
    const uint64_t second = ms / 1000;

    if (!CANSER_LIKELY(self->has_second && second == self->second)) {
        set_second(self, second);
        if (!self->has_second)
            return put_right(out, ms, 9);
    }
    memcpy(out, self->second_text, 8);
    memcpy(out + 6, canser_text_threes + 4 * (ms - 1000 * second), 4);
    return out + 9;
}

CANSER_INLINE uint8_t *put_line(canser_text *self, const canser_frame *frame, unsigned channel,
                                unsigned direction, uint8_t *out)
{
    const bool known = frame->ts != CANSER_NO_TIME;
    const int64_t ts = known ? (int64_t)((uint64_t)frame->ts - (uint64_t)self->start_ns) : 0;
    const uint64_t ns = ts < 0 ? 0 - (uint64_t)ts : (uint64_t)ts, us = ns / 1000, ms = us / 1000;

    self->unknown_times += !known;
    self->cut_times += ns != 1000 * us;
    out = put_number_of_line(self, out);
    *out++ = ' ';
    out =
        CANSER_LIKELY(ts >= 0) ? put_milliseconds(self, out, ms) : put_right(PUT(out, "-"), ms, 8);
    *out++ = '.';
    memcpy(out, canser_text_threes + 4 * (us - 1000 * ms), 4);
    out += 3;
    out = frame->err ? PUT(out, " ER ") : frame->rtr ? PUT(out, " RR ") : PUT(out, " DT ");
    out = put_number(out, channel == CANSER_NO_CHANNEL ? 1 : channel + 1);
    *out++ = ' ';
    const uint64_t id = hex_text(split_hex(frame->id), 'A');
    store_text(out, frame->ext ? id : (id & UINT64_MAX << 32) | (EACH(' ') & UINT32_MAX));
    out = frame->err ? PUT(out, "       -") : out + 8;
    out = direction == CANSER_SENT ? PUT(out, " Tx -  ") : PUT(out, " Rx -  ");
    if (frame->err) {
        self->error_frames++;
        return PUT(out, "5    00 00 00 00 00 \n");
    }
    *out++ = (uint8_t)('0' + frame->dlc);
    if (data_len(frame))
        out = put_spaced(PUT(out, "   "), frame->data, data_len(frame), ' ');
    *out++ = '\n';
    return out;
}

static uint8_t *write(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    return write_lines(self, from, out, out_cap, result, put_line);
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_trc = {"trc", &codec};
