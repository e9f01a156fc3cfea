/* Streams of every kind, fed and flushed with any room for rows: what comes out is what plain.c
 * finds, and no memory but the caller's is touched. */
#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "streams.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

/* What the records promise of every byte, whatever was on the wire. */
static bool is_padding_zero(void)
{
    bool zero = true;

    for (size_t i = 0; i < driven.frame_count; i++) {
        const canser_frame *f = &driven.frames[i];
        zero &= f->ext <= 1 && f->rtr <= 1 && f->err <= 1 && f->dlc <= 8;
        for (int k = f->rtr ? 0 : f->dlc; k < 8; k++)
            zero &= f->data[k] == 0;
    }
    for (size_t i = 0; i < driven.control_count && !driven.no_controls; i++) {
        const canser_control *c = &driven.controls[i];
        for (size_t k = c->len; k < sizeof c->bytes; k++)
            zero &= c->bytes[k] == 0;
    }
    return zero;
}

/* Decode the stream in two pieces, the first one of `first` bytes. */
static void check_decode(const uint8_t *stream, size_t len, size_t first)
{
    drive_begin(&driven, now.protocol, 1000);
    drive_feed(&driven, stream, first, now.frame_cap, now.control_cap);
    if (first < len)
        drive_feed(&driven, stream + first, len - first, now.frame_cap, now.control_cap);

    const char *what = drive_compare(&driven, &open_stream);
    check(!what, what);
    drive_flush(&driven, now.frame_cap, now.control_cap);
    what = drive_compare(&driven, &ended_stream);
    check(!what, what);
    check(is_padding_zero(), "padding is not zero");
}

static void check_stream(const uint8_t *stream, size_t len)
{
    expect_streams(stream, len, 1000);

    /* Room for all and a row more, for all, one row less, 2, and 1; where that
     * is none, or more than enough, room for all and a row more. */
    const size_t frames = ended_stream.frame_count, controls = ended_stream.control_count;
    const size_t frame_caps[] = {frames + 1, frames, frames - 1, 2, 1};
    const size_t control_caps[] = {controls + 1, controls, controls - 1, 1, 2};

    for (int side = 0; side < 2; side++) {
        now.at_end = side;
        for (size_t i = 0; i < sizeof frame_caps / sizeof *frame_caps; i++) {
            now.frame_cap = frame_caps[i] - 1 < frames ? frame_caps[i] : frames + 1;
            now.control_cap = control_caps[i] - 1 < controls ? control_caps[i] : controls + 1;
            for (now.shift = 0; now.shift <= (i == 0 ? SHIFT_MAX : 0); now.shift++)
                check_decode(stream, len, len);
            now.shift = random_below(SHIFT_MAX + 1);
            driven.no_offsets = random_below(4) == 0;
            driven.no_ends = random_below(4) == 0;
            driven.no_controls = random_below(4) == 0;
            check_decode(stream, len, random_below(len + 1));
            driven.no_offsets = driven.no_ends = driven.no_controls = false;
        }
    }
}

void test_decode(void)
{
    uint8_t stream[LEN_MAX];

    begin_part("decode");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (now.kind = 0; now.kind < KIND_COUNT; now.kind++) {
            for (size_t len = 0; len <= LEN_MAX; len++) {
                make_stream(now.protocol, now.kind, stream, len);
                check_stream(stream, len);
            }
        }
    }
}

/* A start mark near the end of the input, and one value from there to the end:
 * for every value a header byte may have, whatever length it claims. */
void test_ends(void)
{
    uint8_t stream[2 * CANSER_PACKET_MAX];

    begin_part("ends");
    now.at_end = true;
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (unsigned value = 0; value < 256; value++) {
            for (size_t len = 1; len <= sizeof stream; len++) {
                memset(stream, (int)value, len);
                stream[0] = (uint8_t)plain_format_of(now.protocol)->alphabet[0];
                expect_streams(stream, len, 1000);
                now.frame_cap = ended_stream.frame_count + 1;
                now.control_cap = ended_stream.control_count + 1;
                check_decode(stream, len, len);
            }
        }
    }
}
