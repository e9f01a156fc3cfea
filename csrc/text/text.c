/* The loops over lines of text, for every format. */
#include "text.h"

#define ROW(name) &canser_text_##name,
static const canser_text_format *const formats[] = {CANSER_TEXTS(ROW)};
#undef ROW

const canser_text_format *canser_text_at(size_t index)
{
    return index < sizeof formats / sizeof *formats ? formats[index] : NULL;
}

/* Check the arrays of a call; `channels` and `directions` may be NULL. Returns a status. */
static int check(const canser_text *self, const canser_frame *frames, const uint8_t *channels,
                 const uint8_t *directions, size_t frame_cap, const uint8_t *bytes, size_t byte_cap)
{
    if (!self || !self->format || (!bytes && byte_cap) || (!frames && frame_cap))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    const span text = span_of(bytes, byte_cap, 1);
    if (spans_meet(text, span_of(frames, frame_cap, sizeof *frames)) ||
        spans_meet(text, span_of(channels, frame_cap, 1)) ||
        spans_meet(text, span_of(directions, frame_cap, 1)))
        return CANSER_OVERLAP;
    return CANSER_OK;
}

int canser_text_add_name(canser_text *self, const char *name, size_t len, uint8_t channel)
{
    if (!self || !name)
        return CANSER_NULL;
    if (!len || len > CANSER_NAME_LEN_MAX || self->name_count >= CANSER_NAMES_MAX)
        return CANSER_RANGE;
    canser_channel_name *const added = &self->names[self->name_count++];
    self->has_name = 0;
    *added = (canser_channel_name){.len = (uint8_t)len, .channel = channel};
    memcpy(added->text, name, len);
    memset((uint8_t *)added->text + len, ' ', 1);
    memset(added->mask, 0xFF, len + 1);
    return CANSER_OK;
}

const uint8_t *canser_text_take_seconds(canser_text *self, const uint8_t *p, int64_t *ns)
{
    const uint64_t high = load_text(p), fraction = load_text(p + 11);
    const unsigned tenth = p[8] - '0', last = p[9] - '0';

    if (p[10] == '.' && count_digits(high) == 8 && tenth <= 9 && last <= 9 &&
        count_digits(fraction) == 6 && *p < '9') {
        const int64_t whole = (int64_t)digits_value(high, 8) * 100 + tenth * 10 + last;
        self->seconds_high = high;
        self->seconds_low = load_le32(p + 8) & 0xFFFFFF;
        self->seconds_ns = whole * 1000000000;
        *ns = self->seconds_ns + (int64_t)digits_value(fraction, 6) * 1000;
        return p + 17;
    }
    return take_fixed(p, 9, ns);
}

/* Read lines from `p` on that start before `stop`, until one is unusual or the rows are full;
 * return the place behind the last line. */
static const uint8_t *read_lines(canser_text *self, const uint8_t *p, const uint8_t *stop,
                                 canser_rows *rows)
{
    const struct canser_text_codec *const codec = self->format->codec;
    size_t count = rows->frame_count;

    while (p < stop && count < rows->frame_cap) {
        text_row row = {&rows->frames[count], CANSER_NO_CHANNEL, CANSER_RECEIVED};
        const uint8_t *const next = codec->read(self, p, &row);
        if (!next) {
            rows->is_unusual = 1;
            break;
        }
        rows->channels[count] = row.channel;
        rows->directions[count] = row.direction;
        if (CANSER_LIKELY(row.direction != SKIPPED)) {
            self->steps_back += row.frame->ts < self->before_ns;
            self->before_ns = row.frame->ts;
            count++;
        }
        rows->line_count++;
        p = next;
    }
    rows->frame_count = count;
    return p;
}

int canser_text_read(canser_text *self, const uint8_t *data, size_t data_len, canser_rows *rows)
{
    if (!rows)
        return CANSER_NULL;
    rows->used = rows->frame_count = rows->line_count = 0;
    rows->is_unusual = 0;
    if ((!rows->channels || !rows->directions) && rows->frame_cap)
        return CANSER_NULL;
    const int status = check(self, rows->frames, rows->channels, rows->directions, rows->frame_cap,
                             data, data_len);
    const span frames = span_of(rows->frames, rows->frame_cap, sizeof *rows->frames),
               channels = span_of(rows->channels, rows->frame_cap, 1),
               directions = span_of(rows->directions, rows->frame_cap, 1);
    if (status)
        return status;
    if (spans_meet(frames, channels) || spans_meet(frames, directions) ||
        spans_meet(channels, directions))
        return CANSER_OVERLAP;
    if (!data_len)
        return CANSER_OK;

    const uint8_t *p = data;
    if (data_len > LINE_WINDOW)
        p = read_lines(self, p, data + data_len - LINE_WINDOW, rows);
    /* Near the end each line is read in a copy, with room for the window behind it. */
    while (!rows->is_unusual && rows->frame_count < rows->frame_cap) {
        uint8_t line[2 * LINE_WINDOW];
        const size_t left = (size_t)(data + data_len - p);
        const uint8_t *const end = left ? memchr(p, '\n', left) : NULL;
        if (!end)
            break;
        const size_t len = (size_t)(end + 1 - p);
        if (len > LINE_WINDOW) {
            rows->is_unusual = 1;
            break;
        }
        memcpy(line, p, len);
        memset(line + len, 0, LINE_WINDOW);
        p += read_lines(self, line, line + 1, rows) - line;
    }
    rows->used = (size_t)(p - data);
    return CANSER_OK;
}

int canser_text_write(canser_text *self, const canser_frame *frames, const uint8_t *channels,
                      const uint8_t *directions, size_t frame_count, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    if (!result)
        return CANSER_NULL;
    *result = (canser_encoded){0, 0, CANSER_REFUSAL_NONE};
    const int status = check(self, frames, channels, directions, frame_count, out, out_cap);
    if (status)
        return status;

    const text_frames from = {frames, channels, directions, frame_count};
    const uint8_t *const end = self->format->codec->write(self, &from, out, out_cap, result);

    result->byte_count = (size_t)(end - out);
    return result->refusal ? CANSER_REFUSED : CANSER_OK;
}

/* Put a date and a time of day, UTC, for seconds since 1970. */
static uint8_t *put_date(uint8_t *out, int64_t seconds)
{
    /* Days since 0000-03-01, so that a leap day is the last one of a year. In 400 years there are
     * 146,097 days. Times of 64 bits of nanoseconds lie in the years 1677 to 2262. */
    const uint64_t since = (uint64_t)(seconds + INT64_C(719468) * 86400);
    const uint32_t day = (uint32_t)(since / 86400), time = (uint32_t)(since % 86400);
    const uint32_t era = day / 146097, of_era = day % 146097;
    const uint32_t year = (of_era - of_era / 1460 + of_era / 36524 - of_era / 146096) / 365;
    const uint32_t of_year = of_era - (365 * year + year / 4 - year / 100);
    const uint32_t month = (5 * of_year + 2) / 153; /* 0 is March */

    out = put_digits(out, era * 400 + year + (month >= 10), 4);
    *out++ = '-';
    out = put_digits(out, month < 10 ? month + 3 : month - 9, 2);
    *out++ = '-';
    out = put_digits(out, of_year - (153 * month + 2) / 5 + 1, 2);
    *out++ = ' ';
    out = put_digits(out, time / 3600, 2);
    *out++ = ':';
    out = put_digits(out, time / 60 % 60, 2);
    *out++ = ':';
    return put_digits(out, time % 60, 2);
}

uint32_t canser_text_set_second(canser_text *self, int64_t ts)
{
    uint8_t *p = self->second_text;
    uint32_t ns;

    if (self->is_dated) {
        int64_t second = ts / 1000000000 - (ts % 1000000000 < 0);
        ns = (uint32_t)((uint64_t)ts - (uint64_t)second * 1000000000);
        p = put_date(p, second);
        self->second = (uint64_t)second;
    } else {
        const uint64_t size = ts < 0 ? 0 - (uint64_t)ts : (uint64_t)ts;
        ns = (uint32_t)(size % 1000000000);
        if (ts < 0)
            *p++ = '-';
        p = put_number(p, size / 1000000000);
        self->second = size / 1000000000;
    }
    *p++ = '.';
    /* The text of a negative time is not for the next one: that may be the same second above 0. */
    self->has_second = ts >= 0;
    self->second_len = (uint8_t)(p - self->second_text);
    return ns;
}

#define TEN(d)                                                                                     \
    '0' + d, '0', '0' + d, '1', '0' + d, '2', '0' + d, '3', '0' + d, '4', '0' + d, '5', '0' + d,   \
        '6', '0' + d, '7', '0' + d, '8', '0' + d, '9'
const uint8_t canser_text_pairs[200] = {TEN(0), TEN(1), TEN(2), TEN(3), TEN(4),
                                        TEN(5), TEN(6), TEN(7), TEN(8), TEN(9)};

#define THREES(h, t)                                                                               \
    h, t, '0', 0, h, t, '1', 0, h, t, '2', 0, h, t, '3', 0, h, t, '4', 0, h, t, '5', 0, h, t, '6', \
        0, h, t, '7', 0, h, t, '8', 0, h, t, '9', 0
#define HUNDRED(h)                                                                                 \
    THREES(h, '0'), THREES(h, '1'), THREES(h, '2'), THREES(h, '3'), THREES(h, '4'),                \
        THREES(h, '5'), THREES(h, '6'), THREES(h, '7'), THREES(h, '8'), THREES(h, '9')
const uint8_t canser_text_threes[4000] = {HUNDRED('0'), HUNDRED('1'), HUNDRED('2'), HUNDRED('3'),
                                          HUNDRED('4'), HUNDRED('5'), HUNDRED('6'), HUNDRED('7'),
                                          HUNDRED('8'), HUNDRED('9')};

#define SIXTEEN(h)                                                                                 \
    h, '0', h, '1', h, '2', h, '3', h, '4', h, '5', h, '6', h, '7', h, '8', h, '9', h, 'A', h,     \
        'B', h, 'C', h, 'D', h, 'E', h, 'F'
const uint8_t canser_text_hex[512] = {
    SIXTEEN('0'), SIXTEEN('1'), SIXTEEN('2'), SIXTEEN('3'), SIXTEEN('4'), SIXTEEN('5'),
    SIXTEEN('6'), SIXTEEN('7'), SIXTEEN('8'), SIXTEEN('9'), SIXTEEN('A'), SIXTEEN('B'),
    SIXTEEN('C'), SIXTEEN('D'), SIXTEEN('E'), SIXTEEN('F'),
};
