/* serial: the format of python-can's `serial` interface.
 *
 *     AA | timestamp u32 LE | dlc u8 | id u32 LE | payload, dlc bytes | BB
 *      0   1                  5        6           10
 *
 * Source: python-can's documentation, "CAN over Serial", frame format, and
 * python-can 4.6 for the flags of the id.
 *
 * Known ambiguities:
 * - The documentation's last example ends in 0xBBS: a slip of the pen for 0xBB.
 * - The top bits of the id are flags as in SocketCAN: bit 31 extended, bit 30
 *   remote, bit 29 error. Programs older than python-can 4.6 write none, so an
 *   id over 0x7FF is extended even without its flag.
 * - Remote frames: python-can writes the dlc and no payload, some firmware
 *   sends dlc bytes of filler. If the byte behind the id is the end mark the
 *   frame ends there, else dlc bytes later. Written without payload.
 * - The unit of the timestamp is not in the stream; the caller names it.
 */
#include "protocol.h"

enum { START = 0xAA, END = 0xBB, HEADER = 10 };

/* The flags of the id, by their bits. */
enum { BIT_EXT = 31, BIT_RTR = 30, BIT_ERR = 29 };

/* From the id on. `flagged`, a constant in each call: the remote or the error
 * flag is set. */
CANSER_INLINE probe_result probe_rest(const uint8_t *p, size_t avail, canser_frame *frame,
                                      const bool flagged)
{
    const uint32_t id = load_le32(p + 6), plain = id & ID_EXT_MAX;
    const size_t dlc = p[5];
    const unsigned ext = id >> BIT_EXT | (plain > ID_STD_MAX);
    const unsigned rtr = flagged ? id >> BIT_RTR & 1 : 0, err = flagged ? id >> BIT_ERR & 1 : 0;
    const size_t len = rtr && p[HEADER] == END ? HEADER + 1 : HEADER + dlc + 1;

    if (avail < len)
        return probe_more();
    if (p[len - 1] != END)
        return probe_reject(CANSER_REJECT_END);
    store_frame(frame, plain, ext, rtr, err, dlc, p + HEADER);
    return probe_frame(len);
}

CANSER_COLD probe_result probe_flagged(const uint8_t *p, size_t avail, canser_frame *frame)
{
    return probe_rest(p, avail, frame, true);
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    if (p[0] != START)
        return probe_reject(CANSER_REJECT_MARKER);
    if (avail < 6)
        return probe_more();
    if (p[5] > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);
    if (avail < HEADER + 1)
        return probe_more();
    *raw = load_le32(p + 1);
    if (!CANSER_LIKELY(!(load_le32(p + 6) & (UINT32_C(1) << BIT_RTR | UINT32_C(1) << BIT_ERR))))
        return probe_flagged(p, avail, frame);
    return probe_rest(p, avail, frame, false);
}

CANSER_INLINE int refuse(const canser_frame *frame)
{
    return refuse_frame(frame, true, true);
}

CANSER_INLINE unsigned emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    const unsigned payload_len = frame->rtr ? 0 : frame->dlc;
    const uint32_t flags = (uint32_t)(frame->ext != 0) << BIT_EXT |
                           (uint32_t)(frame->rtr != 0) << BIT_RTR |
                           (uint32_t)(frame->err != 0) << BIT_ERR;
    out[0] = START;
    store_le32(out + 1, raw);
    out[5] = frame->dlc;
    store_le32(out + 6, frame->id | flags);
    memcpy(out + HEADER, frame->data, DLC_MAX); /* the end mark comes over the surplus */
    out[HEADER + payload_len] = END;
    return HEADER + payload_len + 1;
}

#define HAS_CLOCK 1
#include "scan.h"

static const struct canser_codec codec = {scan, encode};

const canser_protocol canser_protocol_serial = {
    .name = "serial",
    .aliases = "python-can",
    .frame_min = HEADER + 1,
    .frame_max = HEADER + DLC_MAX + 1,
    .has_clock = HAS_CLOCK,
    .codec = &codec,
};
