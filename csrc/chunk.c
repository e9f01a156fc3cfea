/* A stretch of a stream, decoded from a guess, and its join to the stream.
 *
 * The scan does not depend on the bytes before: from one position on, every scan finds
 * the same. So a chunk is right if it starts where the stream stands, and the join checks
 * nothing else; otherwise the chunk is thrown away. Two things do depend on the bytes
 * before, and are corrected at the join: a run of skipped bytes across the border, and the
 * device clock.
 */
#include "clock.h"
#include "past.h"

/* Bytes before the stretch that a guess reads. A scan that starts anywhere falls into step
 * with the true one within some packets, or never. In `cantalope`, which has no marks, it
 * mostly takes a few hundred bytes. */
enum { RUN_UP = 4096 };

/* Decode on from data[*pos] up to `stop`, behind what is in the batch already, until it
 * holds `frame_cap` frames. */
static int extend(canser_decoder *decoder, const uint8_t *data, size_t data_len, size_t *pos,
                  size_t stop, canser_batch *batch, size_t frame_cap)
{
    const size_t frames = batch->frame_count, controls = batch->control_count;
    canser_batch rest = *batch;
    size_t used = 0;

    if (*pos >= stop || *pos >= data_len || frames >= frame_cap)
        return CANSER_OK;
    rest.frames += frames;
    rest.frame_cap = frame_cap - frames;
    if (rest.offsets)
        rest.offsets += frames;
    if (rest.ends)
        rest.ends += frames;
    if (rest.controls) {
        rest.controls += controls;
        rest.control_cap -= controls;
    }
    const int status =
        canser_decoder_advance(decoder, data + *pos, data_len - *pos, stop - *pos, &rest, &used);
    *pos += used;
    batch->frame_count = frames + rest.frame_count;
    batch->control_count = controls + rest.control_count;
    return status;
}

int canser_chunk_decode(canser_chunk *self, const canser_protocol *protocol, int64_t tick_ns,
                        const uint8_t *data, size_t data_len, size_t first, size_t stop,
                        uint64_t offset, canser_batch *batch)
{
    if (batch)
        batch->frame_count = batch->control_count = 0;
    if (!self || !protocol || !batch || (!data && data_len) || !batch->frame_cap ||
        (batch->controls && !batch->control_cap))
        return CANSER_NULL;
    first = first < data_len ? first : data_len;

    canser_decoder *const decoder = &self->decoder;
    int status = canser_decoder_init(decoder, protocol, tick_ns);
    size_t pos = first < RUN_UP ? 0 : first - RUN_UP;
    size_t used = 1;

    /* A full array is emptied here: only the place where this scan ends is of use. */
    while (!status && pos < first && used) {
        status =
            canser_decoder_advance(decoder, data + pos, data_len - pos, first - pos, batch, &used);
        pos += used;
    }
    if (status)
        return status;

    const size_t cap = batch->frame_cap;
    const size_t settle_cap = cap < CANSER_SETTLE_MAX ? cap : CANSER_SETTLE_MAX;
    canser_decoder_init(decoder, protocol, tick_ns);
    decoder->stats.bytes_in = self->begin = offset + pos;
    batch->frame_count = batch->control_count = 0;
    /* The first position alone, to see whether a packet starts there; then the frames in
     * which the clock must settle, in ticks; then the rest. */
    decoder->clock.tick_ns = 1;
    status = extend(decoder, data, data_len, &pos, pos < stop ? pos + 1 : pos, batch, settle_cap);
    self->skips_first = decoder->stats.bytes_skipped != 0;
    if (!status)
        status = extend(decoder, data, data_len, &pos, stop, batch, settle_cap);
    if (protocol->has_clock)
        for (size_t i = 0; i < batch->frame_count; i++) {
            self->raws[i] = (uint32_t)batch->frames[i].ts;
            batch->frames[i].ts = (int64_t)((uint64_t)batch->frames[i].ts * (uint64_t)tick_ns);
        }
    decoder->clock.tick_ns = tick_ns;
    if (!status)
        status = extend(decoder, data, data_len, &pos, stop, batch, cap);
    self->end = decoder->stats.bytes_in;
    self->frame_count = self->settled = batch->frame_count;
    self->shift = 0;
    return status;
}

/* Whether the next jump of a clock is measured against the frame before it, whatever came
 * earlier. If this holds for two clocks, they give the same times from here on. */
static bool clock_is_settled(const canser_clock *clock, uint64_t number)
{
    return clock->near_line || number - clock->jump_at >= IN_LINE;
}

/* Continue the stream's clock through the chunk, which was decoded with a clock of its own:
 * frame by frame until both are settled, and from there by one difference. Returns false,
 * with no change, if they do not settle. */
static bool join_clock(canser_decoder *self, canser_chunk *chunk, canser_frame *frames)
{
    const canser_clock *const last = &chunk->decoder.clock;
    const uint64_t before = self->stats.frames;
    const size_t most =
        chunk->frame_count < CANSER_SETTLE_MAX ? chunk->frame_count : CANSER_SETTLE_MAX;
    canser_clock clock = self->clock, own = {.tick_ns = clock.tick_ns};
    canser_stats stats = self->stats, own_stats = {0};
    int64_t times[CANSER_SETTLE_MAX];
    bool settled = false;
    size_t i = 0;

    for (; i < most && !settled; i++) {
        clock_advance(&own, chunk->raws[i], i, &own_stats);
        times[i] = clock_advance(&clock, chunk->raws[i], before + i, &stats);
        settled = clock_is_settled(&own, i) && clock_is_settled(&clock, before + i);
    }
    if (!settled && i < chunk->frame_count)
        return false;
    for (size_t k = 0; k < i; k++)
        frames[k].ts = times[k];
    chunk->settled = i;
    if (i < chunk->frame_count) {
        const uint64_t shift = clock.turned - own.turned;

        chunk->shift = (int64_t)(shift * (uint64_t)clock.tick_ns);
        clock.raw = last->raw;
        if (last->jump_at != own.jump_at) {
            clock.turned = last->turned + shift;
            clock.line = last->line + shift;
            clock.line_at = last->line_at + before;
            clock.jump_at = last->jump_at + before;
            clock.has_line = last->has_line;
            clock.near_line = last->near_line;
        }
    }
    self->clock = clock;
    self->stats.ts_wraps = stats.ts_wraps + chunk->decoder.stats.ts_wraps - own_stats.ts_wraps;
    self->stats.ts_backsteps =
        stats.ts_backsteps + chunk->decoder.stats.ts_backsteps - own_stats.ts_backsteps;
    self->stats.ts_uncertain =
        stats.ts_uncertain + chunk->decoder.stats.ts_uncertain - own_stats.ts_uncertain;
    return true;
}

int canser_decoder_join(canser_decoder *self, canser_chunk *chunk, canser_frame *frames)
{
    if (!self || !chunk || (!frames && chunk->frame_count))
        return CANSER_NULL;
    if (self->carry_len || self->stats.bytes_in != chunk->begin ||
        self->protocol != chunk->decoder.protocol ||
        self->clock.tick_ns != chunk->decoder.clock.tick_ns)
        return CANSER_MISMATCH;
    if (self->protocol->has_clock && !join_clock(self, chunk, frames))
        return CANSER_MISMATCH;

    canser_stats *const stats = &self->stats;
    const canser_stats *const more = &chunk->decoder.stats;
    stats->bytes_in = more->bytes_in;
    stats->bytes_framed += more->bytes_framed;
    stats->bytes_control += more->bytes_control;
    stats->bytes_skipped += more->bytes_skipped;
    stats->frames += more->frames;
    stats->controls += more->controls;
    /* A run of skipped bytes across the border is counted once. */
    stats->resyncs += more->resyncs - (chunk->skips_first && self->skip_end == chunk->begin);
    for (int reason = 0; reason < CANSER_REJECT_COUNT; reason++)
        stats->rejects[reason] += more->rejects[reason];
    if (more->bytes_skipped)
        self->skip_end = chunk->decoder.skip_end;
    return CANSER_OK;
}

int canser_chunk_deliver(const canser_chunk *self, canser_frame *frames, size_t first,
                         size_t frame_count, canser_frame *out)
{
    if (!self || ((!frames || !out) && frame_count))
        return CANSER_NULL;
    if (!frame_count)
        return CANSER_OK;
    const size_t end = first + frame_count;

    if (out == frames + first) {
        /* The frames are in their place; mostly all have their times, too. */
        if (self->shift)
            for (size_t i = first > self->settled ? first : self->settled; i < end; i++)
                frames[i].ts = (int64_t)((uint64_t)frames[i].ts + (uint64_t)self->shift);
        return CANSER_OK;
    }
    for (size_t i = first; i < end; i++, out++) {
        const uint64_t ts = (uint64_t)frames[i].ts;

        store_past(out, load_word((const uint8_t *)&frames[i]));
        store_past(out->data, load_word(frames[i].data));
        store_past(&out->ts, i < self->settled ? ts : ts + (uint64_t)self->shift);
    }
    settle_stores();
    return CANSER_OK;
}
