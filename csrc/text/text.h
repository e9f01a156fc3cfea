/* Private: a format of text, and the tokens of its lines.
 *
 * Tokens are read eight characters at a time, and may read up to LINE_WINDOW bytes behind the start
 * of their line, whatever is there: the caller of a format's functions makes sure that these can be
 * read. Every token has a bound, so that a line never reads further. Each takes a place, and
 * returns the place behind the token, or NULL if there is none; NULL goes through all of them.
 */
#ifndef CANSER_TEXT_H
#define CANSER_TEXT_H

#include "../protocol.h"

#if defined(__x86_64__)
#include <emmintrin.h>
#endif

#define CANSER_DECLARE(name) extern const canser_text_format canser_text_##name;
CANSER_TEXTS(CANSER_DECLARE)
#undef CANSER_DECLARE

/* The longest run of blanks between two tokens. Programs align columns by up to 40. */
enum { BLANKS_MOST = 64 };

/* The bytes behind the start of a line that may be read: most for trc, where up to ten runs of
 * blanks lie between tokens of up to 28 bytes. And the longest line as it is written. */
enum { LINE_WINDOW = 1024, LINE_MOST = 160 };

/* One frame of a line, and what the record has no field for. */
typedef struct {
    canser_frame *frame;
    uint8_t channel;
    uint8_t direction;
} text_row;

/* Frames to be written. */
typedef struct {
    const canser_frame *frames;
    const uint8_t *channels;   /* NULL: none is told */
    const uint8_t *directions; /* NULL: all were received */
    size_t count;
} text_frames;

/* A format of text. */
struct canser_text_codec {
    /* Read the line at `p` into a row; return the place behind its line end. NULL for a line that
     * is unusual, with no change to the state. SKIPPED in row->direction: the line is counted, and
     * is no frame. */
    const uint8_t *(*read)(canser_text *self, const uint8_t *p, text_row *row);
    /* Write frames as lines, by write_lines(). */
    uint8_t *(*write)(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result);
};

/* A line that is no frame of classic CAN, and was counted. */
enum { SKIPPED = 0xFE };

/* The powers of ten up to 10^9. */
static const uint32_t tens[] = {1,      10,      100,      1000,      10000,
                                100000, 1000000, 10000000, 100000000, 1000000000};

#define EACH(byte) (UINT64_C(0x0101010101010101) * (byte))

/* Eight characters, the first one in the lowest byte. */
CANSER_INLINE uint64_t load_text(const uint8_t *p)
{
#if CANSER_BIG_ENDIAN
    return load_le32(p) | (uint64_t)load_le32(p + 4) << 32;
#else
    return load_word(p);
#endif
}

/* The number of bytes below the first one whose top bit is set: 0 to 8. */
CANSER_INLINE unsigned count_below(uint64_t tops)
{
#if defined(__GNUC__)
    return tops ? (unsigned)__builtin_ctzll(tops) / 8 : 8;
#else
    /* Below the lowest bit all bits become ones: the bytes up to there are counted. */
    return tops ? (unsigned)(((((tops & (0 - tops)) - 1) & EACH(1)) * EACH(1)) >> 56) - 1 : 8;
#endif
}

/* The top bit of each of eight characters, up to the first one, that is no digit. A carry out of a
 * byte that is none changes bytes behind it only. */
CANSER_INLINE uint64_t find_no_digit(uint64_t text)
{
    const uint64_t digits = text ^ EACH('0');
    return (digits | (digits + EACH(0x7F - 9))) & EACH(0x80);
}

/* How many of eight characters are digits, from the first one on. */
CANSER_INLINE unsigned count_digits(uint64_t text)
{
    return count_below(find_no_digit(text));
}

/* The top bit of each one, up to the first one, that is no hexadecimal digit. */
CANSER_INLINE uint64_t find_no_hex(uint64_t text)
{
    const uint64_t digits = text ^ EACH('0'), letters = (text | EACH(0x20)) ^ EACH(0x60);
    const uint64_t no_digit = digits | (digits + EACH(0x7F - 9)),
                   no_letter = letters | (letters + EACH(0x7F - 6)) | ~(letters + EACH(0x7F));
    return no_digit & no_letter & EACH(0x80);
}

/* How many are hexadecimal digits. */
CANSER_INLINE unsigned count_hex(uint64_t text)
{
    return count_below(find_no_hex(text));
}

/* How many of eight characters are spaces, from the first one on. */
CANSER_INLINE unsigned count_spaces(uint64_t text)
{
    const uint64_t others = text ^ EACH(' ');
    return count_below((others | ((others & EACH(0x7F)) + EACH(0x7F))) & EACH(0x80));
}

/* The number that `count` digits make, 1 to 8. */
CANSER_INLINE uint32_t digits_value(uint64_t text, unsigned count)
{
    /* Zeros before the first digit; then pairs, and pairs of pairs, of digits are joined. */
    uint64_t value = (text & EACH(0x0F)) << (64 - 8 * count);
    value = value * 10 + (value >> 8);
    return (uint32_t)(((value & UINT64_C(0xFF000000FF)) * UINT64_C(0xF424000000064) +
                       (value >> 16 & UINT64_C(0xFF000000FF)) * UINT64_C(0x271000000001)) >>
                      32);
}

/* Eight hexadecimal digits as four bytes, the first one in the lowest byte; characters that are no
 * digits give any bits. */
CANSER_INLINE uint32_t hex_bytes(uint64_t text)
{
    const uint64_t nibbles = (text & EACH(0x0F)) + 9 * (text >> 6 & EACH(1));
    uint64_t value = (nibbles << 4 | nibbles >> 8) & UINT64_C(0x00FF00FF00FF00FF);
    value = (value | value >> 8) & UINT64_C(0x0000FFFF0000FFFF);
    return (uint32_t)(value | value >> 16);
}

CANSER_INLINE uint32_t swap_bytes(uint32_t value)
{
    return value >> 24 | (value >> 8 & 0xFF00) | (value & 0xFF00) << 8 | value << 24;
}

/* The number that `count` hexadecimal digits make, 1 to 8. */
CANSER_INLINE uint32_t hex_value(uint64_t text, unsigned count)
{
    return swap_bytes(hex_bytes(text << (64 - 8 * count)));
}

/* Up to 16 hexadecimal digits, as up to 8 bytes: returns how many digits there are. In `data` lie
 * any bytes behind theirs. */
CANSER_INLINE unsigned load_hex(const uint8_t *p, uint8_t *data)
{
#if defined(__x86_64__)
    const __m128i text = _mm_loadu_si128((const __m128i *)(const void *)p);
    const __m128i number = _mm_sub_epi8(text, _mm_set1_epi8('0'));
    const __m128i letter =
        _mm_sub_epi8(_mm_or_si128(text, _mm_set1_epi8(0x20)), _mm_set1_epi8('a'));
    const __m128i is_number = _mm_cmpeq_epi8(_mm_min_epu8(number, _mm_set1_epi8(9)), number);
    const __m128i is_letter = _mm_cmpeq_epi8(_mm_min_epu8(letter, _mm_set1_epi8(5)), letter);
    const __m128i digits =
        _mm_or_si128(_mm_and_si128(is_number, number),
                     _mm_and_si128(is_letter, _mm_add_epi8(letter, _mm_set1_epi8(10))));
    const __m128i bytes = _mm_or_si128(
        _mm_and_si128(_mm_slli_epi16(digits, 4), _mm_set1_epi16(0xFF)), _mm_srli_epi16(digits, 8));

    _mm_storel_epi64((__m128i *)(void *)data, _mm_packus_epi16(bytes, bytes));
    return (unsigned)__builtin_ctz(
        ~(unsigned)_mm_movemask_epi8(_mm_or_si128(is_number, is_letter)));
#else
    const uint64_t first = load_text(p), second = load_text(p + 8);
    const unsigned count = count_hex(first);

    store_le32(data, hex_bytes(first));
    store_le32(data + 4, hex_bytes(second));
    return count < 8 ? count : 8 + count_hex(second);
#endif
}

/* Up to 16 decimal digits. */
CANSER_INLINE const uint8_t *take_number(const uint8_t *p, uint64_t *value)
{
    if (!p)
        return NULL;
    uint64_t text = load_text(p);
    unsigned count = count_digits(text);

    if (!count)
        return NULL;
    *value = digits_value(text, count);
    if (count < 8)
        return p + count;
    text = load_text(p += 8);
    count = count_digits(text);
    if (!count)
        return p;
    *value = *value * (count < 8 ? tens[count] : 100000000) + digits_value(text, count);
    return count < 8 || (unsigned)(p[8] - '0') > 9 ? p + count : NULL;
}

/* A decimal number, with up to `places` decimal places, as a whole number of units of its last
 * place: -1.5 with 3 places is -1500. */
CANSER_INLINE const uint8_t *take_fixed(const uint8_t *p, unsigned places, int64_t *value)
{
    if (!p)
        return NULL;
    const bool negative = *p == '-';
    uint64_t whole, fraction = 0;

    p = take_number(p + negative, &whole);
    if (!p || whole >= (uint64_t)INT64_MAX / tens[places])
        return NULL;
    if (*p == '.') {
        const uint64_t text = load_text(++p);
        unsigned count = count_digits(text);

        if (count)
            fraction = digits_value(text, count);
        if (count == 8 && (unsigned)(p[8] - '0') <= 9) {
            fraction = fraction * 10 + (p[8] - '0');
            if ((unsigned)(p[count = 9] - '0') <= 9)
                return NULL;
        }
        if (count > places)
            return NULL;
        fraction *= tens[places - count];
        p += count;
    }
    *value = (int64_t)(whole * tens[places] + fraction);
    if (negative)
        *value = -*value;
    return p;
}

/* Seconds of ten digits, a point and six digits, as most logs have them; else as take_fixed() reads
 * them. */
const uint8_t *canser_text_take_seconds(canser_text *self, const uint8_t *p, int64_t *ns);

/* Seconds, of which most lines have the same as the line before. */
CANSER_INLINE const uint8_t *take_seconds(canser_text *self, const uint8_t *p, int64_t *ns)
{
    if (!p)
        return NULL;
    const uint64_t high = load_text(p), fraction = load_text(p + 11);
    const uint32_t low = load_le32(p + 8) & 0xFFFFFF; /* with the point */

    if (CANSER_LIKELY(low && low == self->seconds_low && high == self->seconds_high &&
                      count_digits(fraction) == 6)) {
        *ns = self->seconds_ns + (int64_t)digits_value(fraction, 6) * 1000;
        return p + 17;
    }
    return canser_text_take_seconds(self, p, ns);
}

/* One character. */
CANSER_INLINE const uint8_t *take_char(const uint8_t *p, char wanted)
{
    return p && *p == (uint8_t)wanted ? p + 1 : NULL;
}

CANSER_INLINE bool is_blank(uint8_t c)
{
    return c == ' ' || c == '\t';
}

/* Any blanks, or none. */
CANSER_INLINE const uint8_t *skip_blanks(const uint8_t *p)
{
    if (!p)
        return NULL;
    const uint8_t *const end = p + BLANKS_MOST;
    while (is_blank(*p))
        if (++p == end)
            return NULL;
    return p;
}

/* At least one blank. */
CANSER_INLINE const uint8_t *take_blanks(const uint8_t *p)
{
    return p && is_blank(*p) ? skip_blanks(p + 1) : NULL;
}

/* The end of a line, with blanks before it. */
CANSER_INLINE const uint8_t *take_end(const uint8_t *p)
{
    if (p && *p == '\n')
        return p + 1;
    p = skip_blanks(p);
    if (p && *p == '\r')
        p++;
    return take_char(p, '\n');
}

/* The rest of a line. */
CANSER_INLINE const uint8_t *skip_line(const uint8_t *p, const uint8_t *line)
{
    const uint8_t *const end = memchr(p, '\n', (size_t)(line + LINE_WINDOW - p));
    return end ? end + 1 : NULL;
}

/* A byte of one or two hexadecimal digits. */
CANSER_INLINE const uint8_t *take_byte(const uint8_t *p, uint8_t *value)
{
    static const int8_t digit[256] = {
        ['0'] = 1,  ['1'] = 2,  ['2'] = 3,  ['3'] = 4,  ['4'] = 5,  ['5'] = 6,
        ['6'] = 7,  ['7'] = 8,  ['8'] = 9,  ['9'] = 10, ['A'] = 11, ['B'] = 12,
        ['C'] = 13, ['D'] = 14, ['E'] = 15, ['F'] = 16, ['a'] = 11, ['b'] = 12,
        ['c'] = 13, ['d'] = 14, ['e'] = 15, ['f'] = 16,
    };
    const int high = digit[p[0]], low = digit[p[1]];

    if (!high)
        return NULL;
    /* A branch, which is guessed: so the next byte does not wait for this one. */
    if (CANSER_LIKELY(low)) {
        *value = (uint8_t)((high - 1) << 4 | (low - 1));
        return p + 2;
    }
    *value = (uint8_t)(high - 1);
    return p + 1;
}

/* `count` bytes of one or two hexadecimal digits, `gap` before each: for a space any blank. */
CANSER_INLINE const uint8_t *take_short_bytes(const uint8_t *p, size_t count, char gap,
                                              uint8_t *data)
{
    for (size_t i = 0; p && i < count; i++)
        p = *p == (uint8_t)gap || (gap == ' ' && is_blank(*p)) ? take_byte(p + 1, &data[i]) : NULL;
    return p;
}

/* Four pairs of characters, each behind a gap, as eight characters. */
CANSER_INLINE uint64_t load_pairs(const uint8_t *p)
{
    return load_le16(p + 1) | load_le16(p + 4) << 16 | (uint64_t)load_le16(p + 7) << 32 |
           (uint64_t)load_le16(p + 10) << 48;
}

/* `count` bytes of hexadecimal digits, up to eight, `gap` before each: for a space any blank.
 * Behind the bytes of `data` that count lie any. */
CANSER_INLINE const uint8_t *take_gapped(const uint8_t *p, size_t count, char gap, uint8_t *data)
{
    /* The characters that count: two digits of each byte, and the gaps before them as they lie in
     * `gaps`. All are looked at, without a branch: lengths of mixed traffic are not guessed. */
    static const uint64_t of_digits[2 * DLC_MAX - 3] = {
        0,          0,          0,          0,
        0,          0xFFFF,     0xFFFFFFFF, 0xFFFFFFFFFFFF,
        UINT64_MAX, UINT64_MAX, UINT64_MAX, UINT64_MAX,
        UINT64_MAX,
    };
    static const uint64_t of_gaps[DLC_MAX + 1] = {
        0,
        UINT64_C(0x00000000000000FF),
        UINT64_C(0x00000000FF0000FF),
        UINT64_C(0x00FF0000FF0000FF),
        UINT64_C(0x00FF0000FF00FFFF),
        UINT64_C(0x00FF00FFFF00FFFF),
        UINT64_C(0xFFFF00FFFF00FFFF),
        UINT64_C(0xFFFF00FFFFFFFFFF),
        UINT64_MAX,
    };

    const uint64_t first = load_pairs(p), second = load_pairs(p + 12);
    const uint64_t gaps = (load_text(p) & UINT64_C(0x00FF0000FF0000FF)) |
                          (load_text(p + 8) & UINT64_C(0xFF0000FF0000FF00)) |
                          (load_text(p + 16) & UINT64_C(0x0000FF0000FF0000));
    if (CANSER_LIKELY(!((find_no_hex(first) & of_digits[count + 4]) |
                        (find_no_hex(second) & of_digits[count]) |
                        ((gaps ^ EACH((uint8_t)gap)) & of_gaps[count])))) {
        store_le32(data, hex_bytes(first));
        store_le32(data + 4, hex_bytes(second));
        return p + 3 * count;
    }
    return take_short_bytes(p, count, gap, data);
}

/* The same, with any blanks before the first byte, and one before each other one. */
CANSER_INLINE const uint8_t *take_spaced(const uint8_t *p, size_t count, uint8_t *data)
{
    if (count)
        p = take_blanks(p);
    return p ? take_gapped(p - (count != 0), count, ' ', data) : NULL;
}

/* Store the record of a data, a remote or an error frame; false if it is none of classic CAN. */
CANSER_INLINE bool put_frame(canser_frame *frame, int64_t ts, uint32_t id, unsigned ext,
                             unsigned rtr, unsigned err, size_t dlc, const uint8_t *data)
{
    if (dlc > DLC_MAX || id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return false;
    store_frame(frame, id, ext, rtr, err, dlc, data);
    frame->ts = ts;
    return true;
}

/* Set the text of a second; return the nanoseconds behind it. */
uint32_t canser_text_set_second(canser_text *self, int64_t ts);

/* Two characters for each number below 100, three and a zero for each one below 1,000, and two for
 * each byte. */
extern const uint8_t canser_text_pairs[200];
extern const uint8_t canser_text_threes[4000];
extern const uint8_t canser_text_hex[512];

CANSER_INLINE uint8_t *put_text(uint8_t *out, const char *text, size_t len)
{
    memcpy(out, text, len);
    return out + len;
}

#define PUT(out, text) put_text(out, text, sizeof(text) - 1)

/* Eight characters, the first one in the lowest byte. */
CANSER_INLINE void store_text(uint8_t *out, uint64_t text)
{
    store_le32(out, (uint32_t)text);
    store_le32(out + 4, (uint32_t)(text >> 32));
}

/* Eight decimal digits of a number below 10^8, as numbers from 0 to 9. */
CANSER_INLINE uint64_t split_digits(uint32_t value)
{
    /* Fours are split in twos, and twos in digits, all at once: a multiplication and a shift
     * divide by 100 up to 43,698, and by 10 up to 178. */
    const uint64_t fours = value / 10000 | (uint64_t)(value % 10000) << 32,
                   hundreds = (fours * 10486 >> 20) & UINT64_C(0x7F0000007F),
                   twos = hundreds | (fours - 100 * hundreds) << 16,
                   tenths = (twos * 103 >> 10) & UINT64_C(0x000F000F000F000F);
    return tenths | (twos - 10 * tenths) << 8;
}

/* How many of eight digits, as numbers, are zeros before the first other one; the last one is
 * kept. */
CANSER_INLINE unsigned count_zeros(uint64_t digits)
{
    return count_below(((digits + EACH(0x7F)) & EACH(0x80)) | UINT64_C(1) << 63);
}

/* A number of two, four, six or eight digits, with zeros before it. */
CANSER_INLINE uint8_t *put_digits(uint8_t *out, uint32_t value, int count)
{
    for (int at = count - 2; at >= 0; at -= 2, value /= 100)
        memcpy(out + at, canser_text_pairs + 2 * (value % 100), 2);
    return out + count;
}

/* Six digits of a number below 10^6, with zeros before it. Seven bytes are written. */
CANSER_INLINE uint8_t *put_six(uint8_t *out, uint32_t value)
{
    const uint32_t thousands = value / 1000;

    memcpy(out, canser_text_threes + 4 * thousands, 4);
    memcpy(out + 3, canser_text_threes + 4 * (value - 1000 * thousands), 4);
    return out + 6;
}

/* Eight digits, as numbers, without the zeros before them. Eight bytes are written. */
CANSER_INLINE uint8_t *put_short(uint8_t *out, uint64_t digits)
{
    const unsigned zeros = count_zeros(digits);
    store_text(out, (digits | EACH('0')) >> 8 * zeros);
    return out + 8 - zeros;
}

/* A number without zeros before it. Up to seven bytes more are written. */
CANSER_INLINE uint8_t *put_number(uint8_t *out, uint64_t value)
{
    enum { E8 = 100000000 };

    if (value < 10) {
        *out = (uint8_t)('0' + value);
        return out + 1;
    }
    if (value < E8)
        return put_short(out, split_digits((uint32_t)value));
    const uint64_t high = value / E8;
    if (high < E8) {
        out = put_short(out, split_digits((uint32_t)high));
    } else {
        out = put_short(out, split_digits((uint32_t)(high / E8)));
        out = put_digits(out, (uint32_t)(high % E8), 8);
    }
    return put_digits(out, (uint32_t)(value % E8), 8);
}

CANSER_INLINE uint8_t *put_hex(uint8_t *out, uint8_t value)
{
    memcpy(out, canser_text_hex + 2 * (size_t)value, 2);
    return out + 2;
}

/* The eight hexadecimal digits of an id, as numbers. */
CANSER_INLINE uint64_t split_hex(uint32_t value)
{
    const uint64_t halves = value >> 16 | (uint64_t)(value & 0xFFFF) << 32,
                   bytes = (halves >> 8 | halves << 16) & UINT64_C(0x00FF00FF00FF00FF);
    return (bytes >> 4 | bytes << 8) & EACH(0x0F);
}

/* Hexadecimal digits as characters, with letters from `letter_a` on. */
CANSER_INLINE uint64_t hex_text(uint64_t digits, char letter_a)
{
    const uint64_t letters = (digits + EACH(6)) >> 4 & EACH(1);
    return digits + EACH('0') + letters * (uint64_t)(letter_a - '0' - 10);
}

/* Eight bytes as sixteen hexadecimal digits. */
CANSER_INLINE void store_hex(uint8_t *out, const uint8_t *data)
{
#if defined(__x86_64__)
    const __m128i bytes = _mm_loadl_epi64((const __m128i *)(const void *)data);
    const __m128i low = _mm_set1_epi8(0x0F);
    const __m128i digits =
        _mm_unpacklo_epi8(_mm_and_si128(_mm_srli_epi16(bytes, 4), low), _mm_and_si128(bytes, low));
    const __m128i letters =
        _mm_and_si128(_mm_cmpgt_epi8(digits, _mm_set1_epi8(9)), _mm_set1_epi8('A' - '0' - 10));

    _mm_storeu_si128((__m128i *)(void *)out,
                     _mm_add_epi8(_mm_add_epi8(digits, _mm_set1_epi8('0')), letters));
#else
    store_text(out, hex_text(split_hex(swap_bytes(load_le32(data))), 'A'));
    store_text(out + 8, hex_text(split_hex(swap_bytes(load_le32(data + 4))), 'A'));
#endif
}

/* `count` bytes as hexadecimal digits, `gap` before each. All eight are written, without a branch:
 * the lengths of mixed traffic cannot be guessed. */
CANSER_INLINE uint8_t *put_spaced(uint8_t *out, const uint8_t *data, size_t count, char gap)
{
    for (size_t i = 0; i < DLC_MAX; i++) {
        out[3 * i] = (uint8_t)gap;
        put_hex(out + 3 * i + 1, data[i]);
    }
    return out + 3 * count;
}

/* Seconds and a point, or a date and a time of day; the nanoseconds behind are for the caller to
 * write. The text of the line before is copied: most lines have the same second. */
CANSER_INLINE uint8_t *put_seconds(canser_text *self, uint8_t *out, int64_t ts, uint32_t *ns)
{
    const uint64_t since = (uint64_t)ts - self->second * UINT64_C(1000000000);

    if (CANSER_LIKELY(since < 1000000000 && self->has_second && ts >= 0))
        *ns = (uint32_t)since;
    else
        *ns = canser_text_set_second(self, ts);
    memcpy(out, self->second_text, sizeof self->second_text);
    return out + self->second_len;
}

/* Writes a frame, which is one of classic CAN, as a line; returns the place behind it. */
typedef uint8_t *write_line(canser_text *self, const canser_frame *frame, unsigned channel,
                            unsigned direction, uint8_t *out);

/* Write frames as long as there is room for the longest line; up to one that is none of classic
 * CAN. Sets the frames and the refusal of the result; returns the place behind the last line. */
CANSER_INLINE uint8_t *write_lines(canser_text *self, const text_frames *from, uint8_t *out,
                                   size_t out_cap, canser_encoded *result, write_line *write)
{
    const uint8_t *const end = out + out_cap;
    int refusal = CANSER_REFUSAL_NONE;
    size_t i;

    for (i = 0; i < from->count && (size_t)(end - out) >= LINE_MOST; i++) {
        const canser_frame *const frame = &from->frames[i];

        refusal = refuse_frame(frame, true, true);
        if (refusal)
            break;
        out = write(self, frame, from->channels ? from->channels[i] : CANSER_NO_CHANNEL,
                    from->directions ? from->directions[i] : CANSER_RECEIVED, out);
    }
    result->frame_count = i;
    result->refusal = refusal;
    return out;
}

/* The data bytes of a frame; a remote frame has none. */
CANSER_INLINE size_t data_len(const canser_frame *frame)
{
    return frame->rtr ? 0 : frame->dlc;
}

#endif
