/* Private: the loops over a stream, written once and compiled once for each
 * protocol. A protocol file defines, and then includes this:
 *
 *   HAS_CLOCK   1 if its frames carry a device timestamp, else 0
 *   HAS_EXT     1 if it has extended frames, else 0
 *   HAS_ERR     1 if it has error frames, else 0
 *   FRAME_MIN   the shortest frame in bytes
 *   FRAME_MAX   the longest frame in bytes
 *   probe()     what starts at `p`, of which `avail` bytes are the stream's and
 *               SCAN_WINDOW may be read. Checks the bytes in the order in which
 *               they arrive, so that a reject and its reason never depend on
 *               how many bytes are there. Writes `frame` (all but ts) and `raw`
 *               (the device timestamp) only where it finds a frame.
 *   probe_plain()  the same for the frames that a bus is full of, where a whole
 *               window is there: true, with `p` behind the frame, or false if
 *               probe() must tell. `lead` is the byte that tells the length of
 *               the frame at `p`: loaded one frame ahead, as all waits for it.
 *               May write what it is given at any time.
 *   begin_plain()  the first `lead`; false if no plain frame starts at `p`
 *   survey()    with vectors: where among 64 positions a packet starts, and why none
 *               does at the others. If it need not be `exact`, a constant in each
 *               call, positions that only probe() can tell may be open, too.
 *   emit()      one frame to the wire; returns the place behind it, never over
 *               SCAN_WINDOW bytes on, and may write so many. `raw` is the device
 *               timestamp to send.
 *   emit_plain()  the same for a frame that take_apart() let pass.
 */
#include "clock.h"

/* How far ahead of the scan the caches are asked, in bytes and in records: a few
 * times what passes during one access to memory. */
enum { PREFETCH_IN = 1024, PREFETCH_OUT = 128 };

/* A reject so few bytes behind the last one is one of many. */
enum { NOISE_REACH = 8 };

#if CANSER_VECTOR

/* Count the rejects among the surveyed positions that were skipped, all but those for
 * SURVEY_REST. Returns how many. */
CANSER_INLINE uint64_t count_rejects(canser_stats *stats, const surveyed *seen, uint64_t skipped)
{
    uint64_t total = 0;

/* What a wire format never says is a constant zero, and folds away. */
#define COUNT(reason, mask)                                                                        \
    if (mask) {                                                                                    \
        const uint64_t count = count_bits((mask) & skipped);                                       \
        stats->rejects[reason] += count;                                                           \
        total += count;                                                                            \
    }
    COUNT(CANSER_REJECT_TYPE, seen->type)
    COUNT(CANSER_REJECT_DLC, seen->dlc)
    COUNT(CANSER_REJECT_ID, seen->id)
    COUNT(CANSER_REJECT_END, seen->end)
    COUNT(CANSER_REJECT_SUM, seen->sum)
    COUNT(CANSER_REJECT_FIELD, seen->field)
    COUNT(CANSER_REJECT_COMMAND, seen->command)
#undef COUNT
    return total;
}

/* From `p`, over rejects, to the first position where something else is found,
 * or where fewer than SURVEY positions are left. */
CANSER_INLINE const uint8_t *resync_surveys(canser_stats *stats, const uint8_t *p,
                                            const uint8_t *stop)
{
    /* Behind noise the next frame is near: one position, then a few candidates are
     * sooner asked than all are surveyed. Where that does not find it, an exact survey
     * takes the same time whatever the bytes are. */
    bool exact = false;

    if (p < stop) {
        canser_frame scratch;
        uint32_t raw;
        const probe_result found = probe(p, SCAN_WINDOW, &scratch, &raw);

        if (found.kind != PROBE_REJECT)
            return p;
        stats->rejects[found.value]++;
        p++;
    }
    while (stop - p >= SURVEY) {
        const surveyed seen = exact ? survey(p, true) : survey(p, false);
        uint64_t left = seen.open, skipped = UINT64_MAX;
        size_t passed = SURVEY, counted = 0;

        while (left) {
            canser_frame scratch;
            uint32_t raw;
            const size_t at = lowest_bit(left);
            const probe_result found =
                exact ? probe_frame(0) : probe(p + at, SCAN_WINDOW, &scratch, &raw);

            if (found.kind != PROBE_REJECT) {
                passed = at;
                skipped = (UINT64_C(1) << at) - 1;
                break;
            }
            stats->rejects[found.value]++;
            counted++;
            left &= left - 1;
        }
        counted += count_rejects(stats, &seen, skipped);
        stats->rejects[SURVEY_REST] += passed - counted;
        p += passed;
        if (passed < SURVEY)
            break;
        exact = true;
    }
    return p;
}

#endif

/* From a reject at `p`, for `reason`, to the next position where something else
 * is found, or the end of the scan. */
CANSER_NOINLINE const uint8_t *resync(canser_decoder *self, const uint8_t *p, const uint8_t *stop,
                                      const uint8_t *end, uint64_t offset, size_t reason,
                                      const scan_mode mode)
{
    canser_stats *const stats = &self->stats;
    const uint8_t *const begin = p;
    canser_frame scratch;
    uint32_t raw;

    stats->resyncs += offset != self->skip_end;
    stats->rejects[reason]++;
    /* Step one byte, not one packet: a false marker may have swallowed the start
     * of a good frame, and that frame must still be found. */
    p++;
#if CANSER_VECTOR
    if (mode == SCAN_BODY)
        p = resync_surveys(stats, p, stop);
#endif
    while (p < stop) {
        const size_t avail = mode == SCAN_BODY ? (size_t)SCAN_WINDOW : (size_t)(end - p);
        const probe_result found = probe(p, avail, &scratch, &raw);

        if (found.kind == PROBE_REJECT)
            stats->rejects[found.value]++;
        else if (found.kind == PROBE_MORE && mode == SCAN_END)
            stats->rejects[CANSER_REJECT_CUT]++;
        else
            break;
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

/* Where a run of plain frames stopped. */
typedef struct {
    const uint8_t *p;
    canser_frame *frame;
} plain_stop;

/* Plain frames from `p` on, until one is no plain frame, or the clock does more than
 * a small step, or `until` is reached. `shift`: what makes an address the stream
 * offset of its byte. */
CANSER_INLINE plain_stop plain_loop(const uint8_t *p, canser_frame *frame,
                                    canser_frame *const until, canser_clock *clock,
                                    int64_t *offsets, int64_t *ends, const uint64_t shift)
{
    /* Among small steps the time is a line. */
    const uint64_t tick_ns = (uint64_t)clock->tick_ns, turned_ns = clock->turned * tick_ns;
    uint64_t before = clock->raw;
    size_t lead;

    if (!begin_plain(p, &lead))
        return (plain_stop){p, frame};
    do {
        const uint8_t *next = p;
        uint32_t raw;

        CANSER_PREFETCH_READ((const void *)((uintptr_t)p + PREFETCH_IN));
        CANSER_PREFETCH_WRITE((const void *)((uintptr_t)frame + PREFETCH_OUT * sizeof *frame));
        if (!CANSER_LIKELY(probe_plain(&next, &lead, frame, &raw)))
            break;
        frame->ts = CANSER_NO_TIME;
        if (HAS_CLOCK) {
            if (!CANSER_LIKELY(clock_is_small_step(before, raw)))
                break;
            before = raw;
            frame->ts = (int64_t)(turned_ns + raw * tick_ns);
        }
        if (offsets)
            *offsets++ = (int64_t)((uintptr_t)p + shift);
        if (ends)
            *ends++ = (int64_t)((uintptr_t)next + shift);
        frame++;
        p = next;
    } while (CANSER_LIKELY(frame < until));
    if (HAS_CLOCK)
        clock->raw = (uint32_t)before;
    return (plain_stop){p, frame};
}

/* Functions of their own, so that here, where a decoder spends its time, no
 * register and no jump is lost to what is rare, or to offsets nobody asked for. */
CANSER_NOINLINE plain_stop take_plain(const uint8_t *p, canser_frame *frame, canser_frame *until,
                                      canser_clock *clock)
{
    return plain_loop(p, frame, until, clock, NULL, NULL, 0);
}

CANSER_NOINLINE plain_stop take_plain_offsets(const uint8_t *p, canser_frame *frame,
                                              canser_frame *until, canser_clock *clock,
                                              int64_t *offsets, uint64_t shift)
{
    return plain_loop(p, frame, until, clock, offsets, NULL, shift);
}

/* With ends; `offsets` may be NULL. */
CANSER_NOINLINE plain_stop take_plain_ends(const uint8_t *p, canser_frame *frame,
                                           canser_frame *until, canser_clock *clock,
                                           int64_t *offsets, int64_t *ends, uint64_t shift)
{
    return plain_loop(p, frame, until, clock, offsets, ends, shift);
}

#if CANSER_VECTOR

/* Whether a reject at `p` is one of many, with input and room enough for scan_noise(). */
CANSER_INLINE bool is_noise(const canser_decoder *self, const uint8_t *p, const uint8_t *stop,
                            ptrdiff_t room, uint64_t offset)
{
    return offset != self->skip_end && offset - self->skip_end < NOISE_REACH &&
           stop - p >= SURVEY && room > SURVEY / FRAME_MIN;
}

/* From a reject at `p`, through noise that is full of frames: survey SURVEY positions,
 * take the frames among them, and count all that they do not cover. Until among so many
 * there is no frame or nothing else, a control packet is found, or too little is left of
 * the input or the room. `offset` is that of the reject, `number` that of the next frame. */
CANSER_NOINLINE const uint8_t *scan_noise(canser_decoder *self, const uint8_t *p,
                                          const uint8_t *stop, uint64_t offset, canser_batch *batch,
                                          uint64_t number)
{
    canser_stats *const stats = &self->stats;
    canser_frame *frame = batch->frames + batch->frame_count;
    const canser_frame *const frames_end = batch->frames + batch->frame_cap;
    int64_t *offsets = batch->offsets ? batch->offsets + batch->frame_count : NULL;
    int64_t *ends = batch->ends ? batch->ends + batch->frame_count : NULL;
    canser_clock clock = self->clock;
    uint64_t skip_end = self->skip_end, bytes_skipped = 0, counted = 0, resyncs = 0;
    bool done = false;

    while (!done && stop - p >= SURVEY && frames_end - frame > SURVEY / FRAME_MIN) {
        const surveyed seen = survey(p, true);
        const canser_frame *const first = frame;
        uint64_t left = seen.open, skipped = 0;
        size_t passed = 0;

        /* Bit 0 of `left` is position `passed`. */
        while (left) {
            const size_t ahead = lowest_bit(left);
            const uint8_t *const found_at = p + passed + ahead;
            uint32_t raw;

            skipped |= ((UINT64_C(1) << ahead) - 1) << passed;
            passed += ahead;
            const probe_result found = probe(found_at, SCAN_WINDOW, frame, &raw);
            if (found.kind != PROBE_FRAME) {
                done = true;
                break;
            }
            frame->ts = HAS_CLOCK ? clock_advance(&clock, raw, number, stats) : CANSER_NO_TIME;
            number++;
            if (offsets)
                *offsets++ = (int64_t)(offset + passed);
            if (ends)
                *ends++ = (int64_t)(offset + passed + found.value);
            frame++;
            left >>= ahead;
            left >>= found.value;
            passed += found.value;
        }
        if (!done && passed < SURVEY) {
            skipped |= UINT64_MAX << passed;
            passed = SURVEY;
        }
        done = done || !skipped || frame == first;
        if (skipped) {
            resyncs += count_bits(skipped & ~(skipped << 1 | (offset == skip_end)));
            skip_end = offset + highest_bit(skipped) + 1;
            bytes_skipped += count_bits(skipped);
            counted += count_rejects(stats, &seen, skipped);
        }
        p += passed;
        offset += passed;
    }
    stats->rejects[SURVEY_REST] += bytes_skipped - counted;
    stats->resyncs += resyncs;
    stats->bytes_skipped += bytes_skipped;
    self->skip_end = skip_end;
    self->clock = clock;
    batch->frame_count = (size_t)(frame - batch->frames);
    return p;
}

#endif

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
    int64_t *const offsets = batch->offsets ? batch->offsets + batch->frame_count : NULL;
    int64_t *const ends = batch->ends ? batch->ends + batch->frame_count : NULL;
    canser_stats *const stats = &self->stats;
    canser_clock clock = self->clock;
    const uint64_t apart = stats->bytes_control + stats->bytes_skipped;
    canser_frame *const begin = frame;
    const uint64_t number_before = stats->frames;
    bool wants_more = false;

    while (p < stop && frame < frames_end) {
        /* So many frames surely fit: among them nothing asks for the end. */
        const size_t room = (size_t)(frames_end - frame);
        const size_t sure = mode == SCAN_BODY ? (size_t)(stop - p - 1) / FRAME_MAX + 1 : 1;
        canser_frame *const until = frame + (sure < room ? sure : room);
        probe_result found = probe_frame(0);

        do {
            if (mode == SCAN_BODY) {
                const ptrdiff_t done = frame - begin;
                const uint64_t shift = base - (uintptr_t)data;
                const plain_stop at =
                    ends ? take_plain_ends(p, frame, until, &clock, offsets ? offsets + done : NULL,
                                           ends + done, shift)
                    : offsets ? take_plain_offsets(p, frame, until, &clock, offsets + done, shift)
                              : take_plain(p, frame, until, &clock);

                p = at.p;
                frame = at.frame;
                if (frame == until)
                    break;
            }
            const size_t avail = mode == SCAN_BODY ? (size_t)SCAN_WINDOW : (size_t)(end - p);
            const uint64_t number = number_before + (uint64_t)(frame - begin);
            uint32_t raw;

            found = probe(p, avail, frame, &raw);
            if (found.kind != PROBE_FRAME)
                break;
            frame->ts = HAS_CLOCK ? clock_advance(&clock, raw, number, stats) : CANSER_NO_TIME;
            if (offsets)
                offsets[frame - begin] = (int64_t)(base + (uint64_t)(p - data));
            if (ends)
                ends[frame - begin] = (int64_t)(base + (uint64_t)(p - data) + found.value);
            frame++;
            p += found.value;
        } while (frame < until);

        const uint64_t offset = base + (uint64_t)(p - data);
        if (found.kind == PROBE_CONTROL) {
            if (!take_control(self, p, found.value, offset, batch))
                break;
            p += found.value;
        } else if (found.kind == PROBE_MORE && mode != SCAN_END) {
            wants_more = true;
            break;
        } else if (found.kind != PROBE_FRAME) {
            const size_t reason = found.kind == PROBE_REJECT ? found.value : CANSER_REJECT_CUT;
#if CANSER_VECTOR
            if (mode == SCAN_BODY && is_noise(self, p, stop, frames_end - frame, offset)) {
                const uint8_t *const before = p;

                batch->frame_count = (size_t)(frame - batch->frames);
                self->clock = clock;
                p = scan_noise(self, p, stop, offset, batch,
                               number_before + (uint64_t)(frame - begin));
                clock = self->clock;
                frame = batch->frames + batch->frame_count;
                if (p != before)
                    continue;
            }
#endif
            p = resync(self, p, stop, end, offset, reason, mode);
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

/* A time in ticks, rounded down; C rounds to zero. The common units are constants: a
 * division by one is a multiplication. */
CANSER_INLINE uint32_t count_ticks(int64_t ts, int64_t tick_ns)
{
    const int64_t ticks = tick_ns == 1000000 ? ts / 1000000
                          : tick_ns == 1000  ? ts / 1000
                                             : ts / tick_ns;
    return (uint32_t)(ticks - (ts < ticks * tick_ns));
}

/* Where a run of plain frames to send stopped. */
typedef struct {
    const canser_frame *frame;
    uint8_t *out;
} emit_stop;

/* Plain frames from `frame` on, until one is no plain frame, or `until` is reached. */
CANSER_INLINE emit_stop emit_loop(const canser_frame *frame, const canser_frame *const until,
                                  const int64_t tick_ns, uint8_t *out)
{
    do {
        plain_frame plain;
        uint64_t ticks = 0;

        CANSER_PREFETCH_READ((const void *)((uintptr_t)frame + PREFETCH_OUT * sizeof *frame));
        if (!CANSER_LIKELY(take_apart(frame, HAS_EXT, &plain)))
            break;
        if (HAS_CLOCK) {
            /* A time before zero is rare, and no time is one of them. */
            if (!CANSER_LIKELY(frame->ts >= 0))
                break;
            ticks = (uint64_t)frame->ts / (uint64_t)tick_ns;
        }
        out = emit_plain(&plain, (uint32_t)ticks, frame->data, out);
        frame++;
    } while (CANSER_LIKELY(frame < until));
    return (emit_stop){frame, out};
}

/* A function of its own, as take_plain() is. The common units are constants here, too. */
CANSER_NOINLINE emit_stop put_plain(const canser_frame *frame, const canser_frame *until,
                                    int64_t tick_ns, uint8_t *out)
{
    if (HAS_CLOCK && tick_ns == 1000000)
        return emit_loop(frame, until, 1000000, out);
    if (HAS_CLOCK && tick_ns == 1000)
        return emit_loop(frame, until, 1000, out);
    return emit_loop(frame, until, tick_ns, out);
}

/* Why the format cannot carry a frame: CANSER_REFUSAL_*, NONE where it can. */
static int refuse(const canser_frame *frame)
{
    const int refusal = refuse_frame(frame, HAS_EXT, HAS_ERR);

    return !refusal && HAS_CLOCK && frame->ts == CANSER_NO_TIME ? CANSER_REFUSAL_TIME : refusal;
}

static void encode(const canser_frame *frames, size_t frame_count, int64_t tick_ns, uint8_t *out,
                   size_t out_cap, canser_encoded *result)
{
    const canser_frame *frame = frames;
    const canser_frame *const end = frames + frame_count;
    uint8_t *const begin = out;
    uint8_t *const out_end = out + out_cap;
    int refusal = CANSER_REFUSAL_NONE;

    while (frame < end && out_end - out >= SCAN_WINDOW && !refusal) {
        /* So many frames surely fit: among them nothing asks for the room. */
        const size_t room = (size_t)(out_end - out - SCAN_WINDOW) / FRAME_MAX + 1;
        const size_t left = (size_t)(end - frame);
        const canser_frame *const until = frame + (left < room ? left : room);

        do {
            const emit_stop at = put_plain(frame, until, tick_ns, out);

            frame = at.frame;
            out = at.out;
            if (frame == until)
                break;
            refusal = refuse(frame);
            if (refusal)
                break;
            out = emit(frame, HAS_CLOCK ? count_ticks(frame->ts, tick_ns) : 0, out);
            frame++;
        } while (frame < until);
    }
    result->frame_count = (size_t)(frame - frames);
    result->byte_count = (size_t)(out - begin);
    result->refusal = refusal;
}
