/* A stream of bytes, cut into pieces, and its end. */
#include "protocol.h"

/* Python relies on this layout, so every compiler must keep it. */
_Static_assert(sizeof(canser_frame) == 24, "the record is 24 bytes");
_Static_assert(offsetof(canser_frame, data) == 8, "data lies at 8");
_Static_assert(offsetof(canser_frame, ts) == 16, "ts lies at 16");
_Static_assert(sizeof(canser_control) == 8 + 1 + CANSER_CONTROL_ROOM, "no byte is left over");

const canser_protocol *canser_protocol_at(size_t index)
{
#define CANSER_ROW(name, packet_max) &canser_protocol_##name,
    static const canser_protocol *const table[] = {CANSER_PROTOCOLS(CANSER_ROW)};
#undef CANSER_ROW
    return index < sizeof table / sizeof *table ? table[index] : NULL;
}

const char *canser_reject_name(int reason)
{
    static const char *const names[CANSER_REJECT_COUNT] = {
        [CANSER_REJECT_MARKER] = "marker", [CANSER_REJECT_TYPE] = "type",
        [CANSER_REJECT_DLC] = "dlc",       [CANSER_REJECT_ID] = "id",
        [CANSER_REJECT_END] = "end",       [CANSER_REJECT_SUM] = "sum",
        [CANSER_REJECT_FIELD] = "field",   [CANSER_REJECT_COMMAND] = "command",
        [CANSER_REJECT_CUT] = "cut",
    };
    return reason >= 0 && reason < CANSER_REJECT_COUNT ? names[reason] : NULL;
}

int canser_decoder_init(canser_decoder *self, const canser_protocol *protocol, int64_t tick_ns)
{
    if (!self || !protocol)
        return CANSER_NULL;
    if (tick_ns < 1)
        return CANSER_TICK;
    memset(self, 0, sizeof *self);
    self->protocol = protocol;
    self->clock.tick_ns = tick_ns;
    self->skip_end = UINT64_MAX; /* no byte was skipped: the first reject is a resync */
    return CANSER_OK;
}

/* Check a batch and its input, and set the counts to zero. Returns a status. */
static int check_batch(canser_batch *batch, const uint8_t *data, size_t data_len)
{
    if (!batch)
        return CANSER_NULL;
    batch->frame_count = 0;
    batch->control_count = 0;
    if (!batch->frames && batch->frame_cap)
        return CANSER_NULL;
    if (misaligned(batch->frames, _Alignof(canser_frame)) ||
        misaligned(batch->offsets, _Alignof(int64_t)) ||
        misaligned(batch->ends, _Alignof(int64_t)) ||
        misaligned(batch->controls, _Alignof(canser_control)))
        return CANSER_MISALIGNED;

    const span spans[] = {
        span_of(data, data_len, 1),
        span_of(batch->frames, batch->frame_cap, sizeof(canser_frame)),
        span_of(batch->offsets, batch->frame_cap, sizeof(int64_t)),
        span_of(batch->ends, batch->frame_cap, sizeof(int64_t)),
        span_of(batch->controls, batch->control_cap, sizeof(canser_control)),
    };
    for (size_t i = 0; i < sizeof spans / sizeof *spans; i++)
        for (size_t k = 0; k < i; k++)
            if (spans_meet(spans[i], spans[k]))
                return CANSER_OVERLAP;
    return CANSER_OK;
}

/* Scan the held bytes, with `data` behind them, in a copy with room for a window
 * behind each of them. Returns the bytes of `data` inside the packets found; bytes that
 * are not decided are held again. */
static size_t scan_carry(canser_decoder *self, const uint8_t *data, size_t data_len,
                         canser_batch *batch, uint64_t base, scan_mode mode)
{
    uint8_t bridge[2 * CANSER_PACKET_MAX + SCAN_WINDOW] = {0};
    const size_t held = self->carry_len;
    const size_t taken = data_len < CANSER_PACKET_MAX ? data_len : CANSER_PACKET_MAX;

    memcpy(bridge, self->carry, held);
    if (taken)
        memcpy(bridge + held, data, taken);
    const scan_stop at =
        self->protocol->codec->scan(self, bridge, 0, held, held + taken, base, batch, mode);
    if (at.pos >= held) {
        self->carry_len = 0;
        return at.pos - held;
    }
    /* A scan lacks bytes only if there are fewer than a longest packet: then all of `data` is
     * in the bridge, and can be held. At a full array only the bytes that were held before
     * stay held. */
    const size_t end = at.wants_more ? held + taken : held;
    self->carry_len = (uint8_t)(end - at.pos);
    memcpy(self->carry, bridge + at.pos, self->carry_len);
    return end - held;
}

int canser_decoder_advance(canser_decoder *self, const uint8_t *data, size_t data_len, size_t stop,
                           canser_batch *batch, size_t *used)
{
    if (used)
        *used = 0;
    const int status = check_batch(batch, data, data_len);
    if (status)
        return status;
    if (!self || !used || !self->protocol || (!data && data_len))
        return CANSER_NULL;
    if (!batch->frame_cap)
        return CANSER_OK;

    const uint64_t offset = self->stats.bytes_in; /* of data[0] */
    size_t pos = 0;

    if (self->carry_len)
        pos = scan_carry(self, data, data_len, batch, offset - self->carry_len, SCAN_EDGE);
    if (!self->carry_len && data_len - pos >= SCAN_WINDOW) {
        const size_t body = data_len - SCAN_WINDOW + 1;

        pos = self->protocol->codec
                  ->scan(self, data, pos, body < stop ? body : stop, data_len, offset, batch,
                         SCAN_BODY)
                  .pos;
    }
    self->stats.bytes_in += pos;
    *used = pos;
    return CANSER_OK;
}

int canser_decoder_feed(canser_decoder *self, const uint8_t *data, size_t data_len,
                        canser_batch *batch, size_t *used)
{
    const int status = canser_decoder_advance(self, data, data_len, data_len, batch, used);
    if (status || !batch->frame_cap)
        return status;

    const size_t pos = *used;
    const size_t tail_len = data_len - pos;
    if (!self->carry_len && tail_len && tail_len < SCAN_WINDOW) {
        uint8_t tail[2 * SCAN_WINDOW] = {0};

        memcpy(tail, data + pos, tail_len);
        const scan_stop at = self->protocol->codec->scan(self, tail, 0, tail_len, tail_len,
                                                         self->stats.bytes_in, batch, SCAN_EDGE);
        size_t taken = at.pos;
        if (at.wants_more) {
            self->carry_len = (uint8_t)(tail_len - at.pos);
            memcpy(self->carry, tail + at.pos, self->carry_len);
            taken = tail_len;
        }
        self->stats.bytes_in += taken;
        *used += taken;
    }
    return CANSER_OK;
}

int canser_decoder_flush(canser_decoder *self, canser_batch *batch)
{
    const int status = check_batch(batch, NULL, 0);
    if (status)
        return status;
    if (!self || !self->protocol)
        return CANSER_NULL;
    if (self->carry_len && batch->frame_cap)
        scan_carry(self, NULL, 0, batch, self->stats.bytes_in - self->carry_len, SCAN_END);
    return CANSER_OK;
}
