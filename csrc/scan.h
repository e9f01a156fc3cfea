/* Private: the loops over a stream, written once and compiled once for each
 * protocol. A protocol file defines, and then includes this:
 *
 *   HAS_CLOCK   1 if its frames carry a device timestamp, else 0
 *   probe()     what starts at `p`, of which `avail` bytes are the stream's and
 *               SCAN_WINDOW may be read. Checks the bytes in the order in which
 *               they arrive, so that a reject and its reason never depend on
 *               how many bytes are there. Writes `frame` (all but ts) and `raw`
 *               (the device timestamp) only where it finds a frame.
 *   emit()      one frame to the wire; returns its length, never over
 *               SCAN_WINDOW. `raw` is the device timestamp to send.
 *   refuse()    CANSER_REFUSAL_NONE, or why the format cannot carry the frame
 */
#include "clock.h"

/* How far ahead of the scan the caches are asked, in bytes and in records: a few
 * times what passes during one access to memory. */
enum { PREFETCH_IN = 1024, PREFETCH_OUT = 128 };

/* From a reject at `p` to the next position where something else is found, or
 * the end of the scan. */
CANSER_COLD const uint8_t *resync(canser_decoder *self, const uint8_t *p, const uint8_t *stop,
                                  const uint8_t *end, uint64_t offset, const scan_mode mode)
{
    canser_stats *const stats = &self->stats;
    const uint8_t *const begin = p;
    canser_frame scratch;
    uint32_t raw;

    stats->resyncs += offset != self->skip_end;
    while (p < stop) {
        const size_t avail = mode == SCAN_BODY ? (size_t)SCAN_WINDOW : (size_t)(end - p);
        const probe_result found = probe(p, avail, &scratch, &raw);

        if (found.kind == PROBE_REJECT)
            stats->rejects[found.value]++;
        else if (found.kind == PROBE_MORE && mode == SCAN_END)
            stats->rejects[CANSER_REJECT_CUT]++;
        else
            break;
        /* Step one byte, not one packet: a false marker may have swallowed
         * the start of a good frame, and that frame must still be found. */
        p++;
    }
    stats->bytes_skipped += (uint64_t)(p - begin);
    self->skip_end = offset + (uint64_t)(p - begin);
    return p;
}

/* Keep a control packet, if it is asked for; false if there is no room. */
CANSER_COLD bool take_control(canser_decoder *self, const uint8_t *p, size_t len, uint64_t offset,
                              canser_batch *batch)
{
    if (batch->controls) {
        if (batch->control_count == batch->control_cap)
            return false;
        canser_control *const control = &batch->controls[batch->control_count++];
        memset(control, 0, sizeof *control);
        control->offset = offset;
        control->len = (uint8_t)len;
        memcpy(control->bytes, p, len);
    }
    self->stats.controls++;
    self->stats.bytes_control += len;
    return true;
}

CANSER_INLINE scan_stop scan_loop(canser_decoder *self, const uint8_t *data, size_t pos,
                                  size_t stop_pos, size_t len, uint64_t base, canser_batch *batch,
                                  const scan_mode mode)
{
    /* What each frame needs is in locals: a store through a byte pointer might
     * change any field in memory, and the compiler would load it again. */
    const uint8_t *p = data + pos;
    const uint8_t *const stop = data + stop_pos;
    const uint8_t *const end = data + len;
    canser_frame *frame = batch->frames + batch->frame_count;
    canser_frame *const frames_end = batch->frames + batch->frame_cap;
    int64_t *const offsets = batch->offsets;
    canser_stats *const stats = &self->stats;
    canser_clock clock = self->clock;
    const uint64_t apart = stats->bytes_control + stats->bytes_skipped;
    canser_frame *const begin = frame;
    const uint64_t number_before = stats->frames;
    bool wants_more = false;

    while (p < stop && frame < frames_end) {
        const size_t avail = mode == SCAN_BODY ? (size_t)SCAN_WINDOW : (size_t)(end - p);
        uint32_t raw = 0;

        if (mode == SCAN_BODY) {
            CANSER_PREFETCH_READ((const void *)((uintptr_t)p + PREFETCH_IN));
            CANSER_PREFETCH_WRITE((const void *)((uintptr_t)frame + PREFETCH_OUT * sizeof *frame));
        }
        const probe_result found = probe(p, avail, frame, &raw);
        if (CANSER_LIKELY(found.kind == PROBE_FRAME)) {
            if (HAS_CLOCK) {
                frame->ts =
                    clock_advance(&clock, raw, number_before + (uint64_t)(frame - begin), stats);
            } else {
                frame->ts = CANSER_NO_TIME;
            }
            if (offsets)
                offsets[frame - batch->frames] = (int64_t)(base + (uint64_t)(p - data));
            frame++;
            p += found.value;
            continue;
        }
        const uint64_t offset = base + (uint64_t)(p - data);
        if (found.kind == PROBE_CONTROL) {
            if (!take_control(self, p, found.value, offset, batch))
                break;
            p += found.value;
        } else if (found.kind == PROBE_MORE && mode != SCAN_END) {
            wants_more = true;
            break;
        } else {
            p = resync(self, p, stop, end, offset, mode);
        }
    }

    const size_t end_pos = (size_t)(p - data);
    batch->frame_count = (size_t)(frame - batch->frames);
    self->clock = clock;
    stats->frames += (uint64_t)(frame - begin);
    stats->bytes_framed += end_pos - pos - (stats->bytes_control + stats->bytes_skipped - apart);
    return (scan_stop){end_pos, wants_more};
}

static scan_stop scan(canser_decoder *self, const uint8_t *data, size_t pos, size_t stop,
                      size_t len, uint64_t base, canser_batch *batch, scan_mode mode)
{
    /* A constant mode in each call: where whole windows are there, the checks
     * for missing bytes fold away. */
    if (mode == SCAN_BODY)
        return scan_loop(self, data, pos, stop, len, base, batch, SCAN_BODY);
    if (mode == SCAN_EDGE)
        return scan_loop(self, data, pos, stop, len, base, batch, SCAN_EDGE);
    return scan_loop(self, data, pos, stop, len, base, batch, SCAN_END);
}

CANSER_INLINE void encode_loop(const canser_frame *frames, size_t frame_count,
                               const int64_t tick_ns, uint8_t *out, size_t out_cap,
                               canser_encoded *result)
{
    size_t count = 0, pos = 0;
    int refusal = CANSER_REFUSAL_NONE;

    while (count < frame_count && out_cap - pos >= SCAN_WINDOW) {
        const canser_frame *const frame = frames + count;
        uint32_t raw = 0;

        CANSER_PREFETCH_READ((const void *)((uintptr_t)frame + PREFETCH_OUT * sizeof *frame));
        refusal = refuse(frame);
        if (HAS_CLOCK && frame->ts == CANSER_NO_TIME && !refusal)
            refusal = CANSER_REFUSAL_TIME;
        if (!CANSER_LIKELY(!refusal))
            break;
        if (HAS_CLOCK) {
            /* C rounds to zero; a time before zero goes down, too. */
            const int64_t ticks = frame->ts / tick_ns;
            raw = (uint32_t)(ticks - (frame->ts % tick_ns < 0));
        }
        pos += emit(frame, raw, out + pos);
        count++;
    }
    result->frame_count = count;
    result->byte_count = pos;
    result->refusal = refusal;
}

static void encode(const canser_frame *frames, size_t frame_count, int64_t tick_ns, uint8_t *out,
                   size_t out_cap, canser_encoded *result)
{
    /* The common units as constants: a division by one is a multiplication. */
    if (tick_ns == 1000000)
        encode_loop(frames, frame_count, 1000000, out, out_cap, result);
    else if (tick_ns == 1000)
        encode_loop(frames, frame_count, 1000, out, out_cap, result);
    else
        encode_loop(frames, frame_count, tick_ns, out, out_cap, result);
}
