/* Private: the loops over a stream, written once and compiled once for each
 * protocol. A protocol file defines, and then includes this:
 *
 *   NAME        as in the list of protocols
 *   HAS_CLOCK   1 if its frames carry a device timestamp, else 0
 *   HAS_EXT     1 if it has extended frames, else 0
 *   HAS_ERR     1 if it has error frames, else 0
 *   FRAME_MIN   the shortest frame in bytes
 *   FRAME_MAX   the longest frame in bytes
 *   PACKET_MAX  the longest packet in bytes, as the list of protocols has it
 *   START_MARK  the byte with which every packet starts; not defined where there is none
 *   probe()     what starts at `p`, of which `avail` bytes are the stream's and
 *               SCAN_WINDOW may be read. Checks the bytes in the order in which
 *               they arrive, so that a reject and its reason do not depend on
 *               `avail`. Writes `frame` (all but ts) and `raw`
 *               (the device timestamp) only where it finds a frame.
 *   emit()      writes one frame; returns the place behind it. It may write up to
 *               SCAN_WINDOW bytes, and uses no more. `raw` is the device timestamp
 *               to send.
 *   HAS_PLAIN   1 if it has fast forms for plain frames, which are most of a bus, else 0:
 *   probe_plain()  as probe(), with a whole window at `p`: true, with `p` behind the
 *               frame, or false if probe() must decide. `lead` is the byte that tells the
 *               length of the frame at `p`. It is loaded one frame ahead, as everything
 *               else waits for it. May write to `frame` and `raw` in any case.
 *   begin_plain()  the first `lead`; false if no plain frame starts at `p`
 *   emit_plain()   as emit(), for a frame that take_apart() let pass.
 */
#include "clock.h"

_Static_assert(FRAME_MIN > 0 && FRAME_MIN <= FRAME_MAX && FRAME_MAX <= PACKET_MAX &&
                   PACKET_MAX <= UINT8_MAX,
               "lengths in order, that fit a byte");
_Static_assert(PACKET_MAX == sizeof((union canser_longest *)0)->NAME,
               "the list of protocols in canser.h says how long packets are");

/* Distance of prefetches ahead of the scan, in bytes of input and in records of output:
 * a few times what is scanned during one access to memory. */
enum { PREFETCH_IN = 1024, PREFETCH_OUT = 128 };

#ifdef START_MARK

/* The least distance in bytes at which memchr finds the next start mark sooner than a loop. */
enum { SEARCH_MIN = 16 };

/* Skip bytes at which no packet starts. */
CANSER_INLINE const uint8_t *skip_to_mark(canser_stats *stats, const uint8_t *p,
                                          const uint8_t *stop)
{
    const uint8_t *const begin = p;
    const uint8_t *const near = stop - p < SEARCH_MIN ? stop : p + SEARCH_MIN;

    while (p < near && *p != START_MARK)
        p++;
    if (p == near && p < stop) {
        p = memchr(p, START_MARK, (size_t)(stop - p));
        p = p ? p : stop;
    }
    stats->rejects[CANSER_REJECT_MARKER] += (uint64_t)(p - begin);
    return p;
}

#endif

/* Go on from a reject at `p`, for `reason`, to the next position with another result,
 * or to the end of the scan. */
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
    while (p < stop) {
#ifdef START_MARK
        if (*p != START_MARK) {
            p = skip_to_mark(stats, p, stop);
            continue;
        }
#endif
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

#if HAS_PLAIN

/* The place at which a run of plain frames stopped. */
typedef struct {
    const uint8_t *p;
    canser_frame *frame;
} plain_stop;

/* Take plain frames from `p` on. Stops at a frame that is not plain, at a step of the clock
 * that is not small, and at `until`. `shift` added to an address gives the stream offset
 * of its byte. */
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

/* Separate functions: a decoder spends its time here, and rare cases, or offsets that are not
 * wanted, would cost registers and jumps. */
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

#endif

CANSER_INLINE scan_stop scan_loop(canser_decoder *self, const uint8_t *data, size_t pos,
                                  size_t stop_pos, size_t len, uint64_t base, canser_batch *batch,
                                  const scan_mode mode)
{
    /* Locals: a store through a byte pointer might change any field in memory, so the
     * compiler would load fields again for each frame. */
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
        /* This many frames fit in any case, so the loop over them does not test for the end. */
        const size_t room = (size_t)(frames_end - frame);
        const size_t sure = mode == SCAN_BODY ? (size_t)(stop - p - 1) / FRAME_MAX + 1 : 1;
        canser_frame *const until = frame + (sure < room ? sure : room);
        probe_result found = probe_frame(0);

        do {
#if HAS_PLAIN
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
#endif
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
    /* The mode is a constant in each call: for SCAN_BODY the compiler removes the checks
     * for missing bytes. */
    if (mode == SCAN_BODY)
        return scan_loop(self, data, pos, stop, len, base, batch, SCAN_BODY);
    if (mode == SCAN_EDGE)
        return scan_loop(self, data, pos, stop, len, base, batch, SCAN_EDGE);
    return scan_loop(self, data, pos, stop, len, base, batch, SCAN_END);
}

/* Return a time in ticks, rounded down; C's division rounds to zero. The common units are
 * constants: a division by a constant is a multiplication. */
CANSER_INLINE uint32_t count_ticks(int64_t ts, int64_t tick_ns)
{
    const int64_t ticks = tick_ns == 1000000 ? ts / 1000000
                          : tick_ns == 1000  ? ts / 1000
                                             : ts / tick_ns;
    return (uint32_t)(ticks - (ts < ticks * tick_ns));
}

#if HAS_PLAIN

/* The place at which a run of plain frames to send stopped. */
typedef struct {
    const canser_frame *frame;
    uint8_t *out;
} emit_stop;

/* Send plain frames from `frame` on. Stops at a frame that is not plain, and at `until`. */
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
            /* Times before zero are rare; CANSER_NO_TIME is one of them. */
            if (!CANSER_LIKELY(frame->ts >= 0))
                break;
            ticks = (uint64_t)frame->ts / (uint64_t)tick_ns;
        }
        out = emit_plain(&plain, (uint32_t)ticks, frame->data, out);
        frame++;
    } while (CANSER_LIKELY(frame < until));
    return (emit_stop){frame, out};
}

/* A separate function, as take_plain() is. The common units are constants here, too. */
CANSER_NOINLINE emit_stop put_plain(const canser_frame *frame, const canser_frame *until,
                                    int64_t tick_ns, uint8_t *out)
{
    if (HAS_CLOCK && tick_ns == 1000000)
        return emit_loop(frame, until, 1000000, out);
    if (HAS_CLOCK && tick_ns == 1000)
        return emit_loop(frame, until, 1000, out);
    return emit_loop(frame, until, tick_ns, out);
}

#endif

/* Return why the format cannot carry a frame: CANSER_REFUSAL_*, NONE if it can. */
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
        /* This many frames fit in any case, so the loop over them does not test for room. */
        const size_t room = (size_t)(out_end - out - SCAN_WINDOW) / FRAME_MAX + 1;
        const size_t left = (size_t)(end - frame);
        const canser_frame *const until = frame + (left < room ? left : room);

        do {
#if HAS_PLAIN
            const emit_stop at = put_plain(frame, until, tick_ns, out);

            frame = at.frame;
            out = at.out;
            if (frame == until)
                break;
#endif
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
