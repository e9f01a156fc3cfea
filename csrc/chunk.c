/* A stretch of a stream, decoded from a guess, and its join to the stream.
 *
 * The rule of the scan knows no past: from one position on, every scan finds the same.
 * So a chunk is right from the first packet on if it starts where the stream stands, and
 * that is all that is asked at the join; where it does not, the chunk is thrown away.
 * What does have a past is made good there: a run of skipped bytes across the border,
 * and the device clock.
 */
#include "clock.h"
#include "vector.h"

int canser_chunk_decode(canser_chunk *self, const canser_protocol *protocol, const uint8_t *data,
                        size_t data_len, size_t first, size_t stop, uint64_t offset,
                        canser_batch *batch)
{
    if (batch)
        batch->frame_count = batch->control_count = 0;
    if (!self || !protocol || !batch || (!data && data_len) || !batch->frame_cap ||
        (batch->controls && !batch->control_cap))
        return CANSER_NULL;
    first = first < data_len ? first : data_len;

    canser_decoder *const tale = &self->tale;
    int status = canser_decoder_init(tale, protocol, 1);
    size_t pos = first < CANSER_RUN_UP ? 0 : first - CANSER_RUN_UP;
    size_t used;

    /* An array that is full on the way is emptied: only where it ends counts. */
    while (!status && pos < first && pos < data_len) {
        status =
            canser_decoder_advance(tale, data + pos, data_len - pos, first - pos, batch, &used);
        if (!used)
            break;
        pos += used;
    }
    if (status)
        return status;

    canser_decoder_init(tale, protocol, 1);
    tale->stats.bytes_in = offset + pos;
    self->begin = offset + pos;
    /* The first position alone, to see whether a packet starts there. */
    status = canser_decoder_advance(tale, data + pos, data_len - pos, pos < stop, batch, &used);
    self->skips_first = tale->stats.bytes_skipped != 0;
    if (!status && used && stop > pos + used) {
        canser_batch rest = *batch;
        const size_t frames = batch->frame_count, controls = batch->control_count;

        pos += used;
        rest.frames += frames;
        rest.frame_cap -= frames;
        rest.offsets = rest.offsets ? rest.offsets + frames : NULL;
        rest.controls = rest.controls ? rest.controls + controls : NULL;
        rest.control_cap -= rest.controls ? controls : 0;
        status = canser_decoder_advance(tale, data + pos, data_len - pos, stop - pos, &rest, &used);
        batch->frame_count += rest.frame_count;
        batch->control_count += rest.control_count;
    }
    self->end = tale->stats.bytes_in;
    self->frame_count = batch->frame_count;
    self->settled = self->frame_count;
    self->shift = 0;
    self->tick_ns = 1;
    return status;
}

/* Whether the next jump will be measured against the frame before it, whatever came
 * earlier. Two clocks of which this is true go on alike. */
static bool clock_is_settled(const canser_clock *clock, uint64_t number)
{
    return clock->near_line || number - clock->jump_at >= IN_LINE;
}

/* Go on with the stream's clock where the chunk had begun with one of its own: frame by
 * frame until both are settled, and from there by one difference. */
static void join_clock(canser_decoder *self, canser_chunk *chunk, canser_frame *frames)
{
    const canser_clock *const last = &chunk->tale.clock;
    canser_clock *const clock = &self->clock;
    canser_stats *const stats = &self->stats;
    const uint64_t before = stats->frames;
    canser_clock own = {.tick_ns = 1};
    canser_stats own_stats = {0};
    size_t i = 0;

    for (bool settled = false; i < chunk->frame_count && !settled; i++) {
        const uint32_t raw = (uint32_t)frames[i].ts;

        clock_advance(&own, raw, i, &own_stats);
        frames[i].ts = clock_advance(clock, raw, before + i, stats);
        settled = clock_is_settled(&own, i) && clock_is_settled(clock, before + i);
    }
    chunk->settled = i;
    chunk->tick_ns = clock->tick_ns;
    chunk->shift = clock->turned - own.turned;
    stats->ts_wraps += chunk->tale.stats.ts_wraps - own_stats.ts_wraps;
    stats->ts_backsteps += chunk->tale.stats.ts_backsteps - own_stats.ts_backsteps;
    if (i == chunk->frame_count)
        return;
    clock->raw = last->raw;
    if (last->jump_at != own.jump_at) {
        clock->turned = last->turned + chunk->shift;
        clock->line = last->line + chunk->shift;
        clock->line_at = last->line_at + before;
        clock->jump_at = last->jump_at + before;
        clock->has_line = last->has_line;
        clock->near_line = last->near_line;
    }
}

int canser_decoder_join(canser_decoder *self, canser_chunk *chunk, canser_frame *frames)
{
    if (!self || !chunk || (!frames && chunk->frame_count))
        return CANSER_NULL;
    if (self->carry_len || self->stats.bytes_in != chunk->begin ||
        self->protocol != chunk->tale.protocol)
        return CANSER_APART;

    canser_stats *const stats = &self->stats;
    const canser_stats *const more = &chunk->tale.stats;
    if (self->protocol->has_clock)
        join_clock(self, chunk, frames);
    stats->bytes_in = more->bytes_in;
    stats->bytes_framed += more->bytes_framed;
    stats->bytes_control += more->bytes_control;
    stats->bytes_skipped += more->bytes_skipped;
    stats->frames += more->frames;
    stats->controls += more->controls;
    /* A run of skipped bytes across the border is one. */
    stats->resyncs += more->resyncs - (chunk->skips_first && self->skip_end == chunk->begin);
    for (int reason = 0; reason < CANSER_REJECT_COUNT; reason++)
        stats->rejects[reason] += more->rejects[reason];
    if (more->bytes_skipped)
        self->skip_end = chunk->tale.skip_end;
    return CANSER_OK;
}

/* A word to memory that nobody reads soon: past the cache where the machine can, which
 * spares the read of each line that is going to be written over. */
CANSER_INLINE void store_past(void *to, uint64_t word)
{
#if CANSER_VECTOR && defined(__SSE2__) && defined(__x86_64__)
    _mm_stream_si64(to, (long long)word);
#else
    memcpy(to, &word, sizeof word);
#endif
}

/* What was stored past the cache is seen by other threads after this. */
CANSER_INLINE void settle_stores(void)
{
#if CANSER_VECTOR && defined(__SSE2__) && defined(__x86_64__)
    _mm_sfence();
#endif
}

int canser_chunk_deliver(const canser_chunk *self, const canser_frame *frames, size_t first,
                         size_t frame_count, canser_frame *out)
{
    if (!self || ((!frames || !out) && frame_count))
        return CANSER_NULL;
    for (size_t i = first; i < first + frame_count; i++) {
        const canser_frame *const frame = &frames[i];
        canser_frame *const target = &out[i - first];
        const uint64_t ts = (uint64_t)frame->ts;
        const uint64_t due = i < self->settled ? ts : (ts + self->shift) * (uint64_t)self->tick_ns;

        if (target == frame) {
            target->ts = (int64_t)due;
            continue;
        }
        store_past(target, load_word((const uint8_t *)frame));
        store_past(target->data, load_word(frame->data));
        store_past(&target->ts, due);
    }
    settle_stores();
    return CANSER_OK;
}
