/* Small calls, for bindings: checks, decoding and the result in one call. */
#include "protocol.h"

#ifndef CANSER_COMPARE_EXCHANGE
#error "protocol.h does not know how this compiler compares and exchanges in one step"
#endif

/* The users of a stream: none, a small call, a caller of canser_stream_take(). */
enum { FREE, FED, TAKEN };

int canser_stream_take(canser_stream *self)
{
    return self && CANSER_COMPARE_EXCHANGE(&self->taken, FREE, TAKEN);
}

void canser_stream_release(canser_stream *self)
{
    if (self)
        (void)CANSER_COMPARE_EXCHANGE(&self->taken, TAKEN, FREE);
}

/* The result of a call that found `count` frames; `rest` is mostly 0. */
static int64_t pack(size_t count, uint64_t rest)
{
    return (int64_t)(count | rest << 32);
}

static int64_t feed(canser_stream *self, const uint8_t *data, size_t data_len, canser_batch *batch)
{
    const canser_decoder before = self->decoder;
    size_t used;

    if (canser_decoder_feed(&self->decoder, data, data_len, batch, &used))
        return -1;
    if (used < data_len && batch->frame_count < batch->frame_cap) {
        self->decoder = before; /* there was no room for a control packet */
        return -1;
    }
    return pack(batch->frame_count, data_len - used);
}

int64_t canser_stream_feed(canser_stream *self, const uint8_t *data, size_t data_len,
                           const canser_target *target)
{
    canser_control no_room;

    if (!self || !target || !target->frame_cap || data_len > CANSER_SMALL_MAX ||
        !CANSER_COMPARE_EXCHANGE(&self->taken, FREE, FED))
        return -1;
    canser_batch batch = {.frames = target->frames,
                          .frame_cap = target->frame_cap,
                          .offsets = target->offsets,
                          .ends = target->ends,
                          .controls = self->keeps_controls ? &no_room : NULL};
    const int64_t found = feed(self, data, data_len, &batch);
    (void)CANSER_COMPARE_EXCHANGE(&self->taken, FED, FREE);
    return found;
}

int64_t canser_decode_small(const canser_protocol *protocol, int64_t tick_ns, const uint8_t *data,
                            size_t data_len, canser_frame *frames, size_t frame_cap)
{
    canser_decoder decoder;
    canser_batch batch = {.frames = frames, .frame_cap = frame_cap};
    size_t used;

    if (data_len > CANSER_SMALL_MAX || canser_decoder_init(&decoder, protocol, tick_ns) ||
        canser_decoder_feed(&decoder, data, data_len, &batch, &used) || used < data_len)
        return -1;
    size_t count = batch.frame_count;
    while (decoder.carry_len) {
        batch.frames = frames + count;
        batch.frame_cap = frame_cap - count;
        if (!batch.frame_cap)
            return -1;
        canser_decoder_flush(&decoder, &batch);
        count += batch.frame_count;
    }
    return pack(count, decoder.stats.bytes_skipped);
}
