/* candump: the log format of can-utils.
 *
 *     (1544106679.432583) can0 562#122DF953813CA2
 *     (1544106679.432600) can0 18FEF100#            extended: eight digits
 *     (1544106679.432610) can0 123#R8               remote, with its dlc
 *     (1544106679.432620) can0 20000080#00          error: bit 29 of eight digits
 *     (1544106679.432630) can1 123#1122 T           the direction, R or T
 *
 * Source: can-utils, candump and the frame notation of its library. Lines of CAN FD (##) are
 * counted. Unusual, and left to the caller: bytes with dots, raw dlcs, CAN XL, comments, names of
 * interfaces that the caller has not set.
 */
#include "text.h"

#define ERR_FLAG UINT32_C(0x20000000)

/* The name of an interface, one that the caller has set. */
CANSER_INLINE const uint8_t *take_name(canser_text *self, const uint8_t *p, uint8_t *channel)
{
    if (!p)
        return NULL;
    const uint64_t first = load_word(p), second = load_word(p + 8);

    /* Mostly that of the line before; then all, from the first on. */
    for (unsigned i = 0, at = self->last_name; i <= self->name_count; i++) {
        const canser_channel_name *const name = &self->names[at];
        if (name->len && !((first ^ name->text[0]) & name->mask[0]) &&
            !((second ^ name->text[1]) & name->mask[1])) {
            self->last_name = (uint8_t)at;
            *channel = name->channel;
            return p + name->len;
        }
        at = i < CANSER_NAMES_MAX ? i : 0;
    }
    return NULL;
}

static const uint8_t *read(canser_text *self, const uint8_t *p, text_row *row)
{
    const uint8_t *const line = p;
    uint8_t data[DLC_MAX] = {0};
    int64_t ts;

    p = take_char(take_seconds(self, take_char(p, '('), &ts), ')');
    p = take_blanks(take_name(self, take_blanks(p), &row->channel));
    if (!p)
        return NULL;
    const uint64_t text = load_text(p);
    const unsigned digits = count_hex(text);
    uint32_t id = hex_value(text, digits ? digits : 1);
    const unsigned ext = digits == 8, err = ext && id >> 29 == 1;
    if ((digits != 3 && digits != 8) || p[digits] != '#')
        return NULL;
    p += digits + 1;

    if (*p == 'R' || *p == 'r') {
        const unsigned dlc = (unsigned)(p[1] - '0');
        const bool told = dlc <= DLC_MAX;
        p += 1 + told;
        if (err || !put_frame(row->frame, ts, id, ext, 1, 0, told ? dlc : 0, data))
            return NULL;
    } else if (*p == '#') {
        p = count_hex(load_text(p + 1)) ? skip_line(p, line) : NULL;
        if (!p)
            return NULL;
        self->fd_count++;
        row->direction = SKIPPED;
        return p;
    } else {
        const unsigned count = load_hex(p, data);
        p += count;
        if (count & 1 ||
            !put_frame(row->frame, ts, err ? id & ID_EXT_MAX : id,
                       err ? (id & ID_EXT_MAX) > ID_STD_MAX : ext, 0, err, count / 2, data))
            return NULL;
    }
    if (*p == ' ' && (p[1] == 'R' || p[1] == 'T')) {
        row->direction = p[1] == 'T' ? CANSER_SENT : CANSER_RECEIVED;
        p += 2;
    }
    return take_end(p);
}

/* Set the name of an interface, with a blank: one that the caller has set, else "can" and the
 * number. */
CANSER_COLD void set_name(canser_text *self, unsigned channel)
{
    uint8_t text[32] = "can";
    uint8_t *end = put_number(text + 3, channel == CANSER_NO_CHANNEL ? 0 : channel);

    *end++ = ' ';
    self->name = (canser_channel_name){.len = (uint8_t)(end - text), .channel = (uint8_t)channel};
    memcpy(self->name.text, text, sizeof self->name.text);
    for (unsigned i = self->name_count; i--;)
        if (self->names[i].channel == channel)
            self->name = self->names[i], self->name.len++;
    self->has_name = 1;
}

CANSER_INLINE uint8_t *put_line(canser_text *self, const canser_frame *frame, unsigned channel,
                                unsigned direction, uint8_t *out)
{
    const bool known = frame->ts != CANSER_NO_TIME;
    uint32_t ns, us;

    *out++ = '(';
    out = put_seconds(self, out, known ? frame->ts : 0, &ns);
    us = ns / 1000;
    /* Branches, as a store for each line takes longer. */
    if (!CANSER_LIKELY(known))
        self->unknown_times++;
    if (!CANSER_LIKELY(ns == 1000 * us))
        self->cut_times++;
    out = PUT(put_six(out, us), ") ");
    if (!CANSER_LIKELY(self->has_name && self->name.channel == channel))
        set_name(self, channel);
    memcpy(out, self->name.text, sizeof self->name.text);
    out += self->name.len;
    /* Eight digits, or the last three of them. */
    const bool is_long = frame->ext || frame->err;
    const uint64_t id = hex_text(split_hex(frame->id | (frame->err ? ERR_FLAG : 0)), 'A');
    store_text(out, is_long ? id : id >> 40);
    out += is_long ? 8 : 3;
    *out++ = '#';
    if (CANSER_LIKELY(!frame->rtr)) {
        store_hex(out, frame->data);
        out += 2 * frame->dlc;
    } else {
        *out++ = 'R';
        *out++ = (uint8_t)('0' + frame->dlc);
    }
    if (direction == CANSER_SENT)
        out = PUT(out, " T");
    *out++ = '\n';
    return out;
}

static uint8_t *write(canser_text *self, const text_frames *from, uint8_t *out, size_t out_cap,
                      canser_encoded *result)
{
    return write_lines(self, from, out, out_cap, result, put_line);
}

static const struct canser_text_codec codec = {read, write};
const canser_text_format canser_text_candump = {"candump", &codec};
