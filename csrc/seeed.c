/* seeed: the USB-CAN analyzer of Seeed, Waveshare and others.
 *
 *     AA | type | id, 2 bytes LE (standard) or 4 bytes LE (extended) | payload | 55
 *     type: 1 1 ext rtr dlc[3..0]
 *
 * and, mixed into the same stream, fixed packets of 20 bytes:
 *
 *     AA 55 | command | 16 bytes | sum
 *      0      2         3          19      sum: low byte of the sum of bytes 2..18
 *
 *     command 01 is a frame, any other a control packet:
 *     AA 55 01 | 1 std, 2 ext | 1 data, 2 remote | id u32 LE | dlc | data[8] | 0 | sum
 *      0         3              4                  5           9     10        18  19
 *
 * Source: Seeed's "Serial port (USB) to CAN protocol definition"; Waveshare's
 * protocol of the USB-CAN-A for the fixed packets.
 *
 * Known ambiguities:
 * - The document's remark that in E2 bit 5 is 0 is a slip: it is 1, extended.
 * - Remote frames: the device fills dlc bytes with anything, python-can writes
 *   none. If the byte behind the id is the end mark the frame ends there, else
 *   dlc bytes later. Written with dlc zero bytes, as the device expects.
 * - AA and 55 inside ids and payloads are normal.
 * - There is no timestamp.
 */
#include "protocol.h"

enum { START = 0xAA, END = 0x55, FIXED = 0x55, FIXED_LEN = 20, FIXED_FRAME = 0x01 };
enum { TYPE_MARK = 0xC0, TYPE_RTR = 0x10, TYPE_DLC = 0x0F };

CANSER_COLD probe_result probe_fixed(const uint8_t *p, canser_frame *frame)
{
    unsigned sum = 0;
    for (int i = 2; i < FIXED_LEN - 1; i++)
        sum += p[i];
    if ((sum & 0xFF) != p[FIXED_LEN - 1])
        return probe_reject(CANSER_REJECT_SUM);
    if (p[2] != FIXED_FRAME)
        return probe_control(FIXED_LEN);

    const bool ext = p[3] == 2, rtr = p[4] == 2;
    const uint32_t id = load_le32(p + 5);
    const unsigned dlc = p[9];
    if ((p[3] != 1 && !ext) || (p[4] != 1 && !rtr) || dlc > DLC_MAX || p[18] != 0 ||
        id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return probe_reject(CANSER_REJECT_FIELD);
    store_frame(frame, id, ext, rtr, 0, dlc, p + 10);
    return probe_frame(FIXED_LEN);
}

/* A variable packet whose header is known to be good, from the id on. `rtr` is
 * a constant in each call. */
CANSER_INLINE probe_result probe_rest(const uint8_t *p, size_t avail, canser_frame *frame,
                                      const bool rtr)
{
    const size_t type = p[1], dlc = type & TYPE_DLC;
    const size_t ext = type >> 5 & 1;
    const size_t header = 4 + (type >> 4 & 2); /* two bytes of id more if extended */
    if (avail < header)
        return probe_more();
    /* Masks, not branches: on mixed traffic nobody can predict the kind. */
    const uint32_t wide = 0 - (uint32_t)ext;
    const uint32_t id = load_le32(p + 2) & (wide | 0xFFFF);
    if (id > (ID_STD_MAX | (wide & ID_EXT_MAX)))
        return probe_reject(CANSER_REJECT_ID);
    if (avail < header + 1)
        return probe_more();
    const size_t len = rtr && p[header] == END ? header + 1 : (dlc + 5) + (type >> 4 & 2);
    if (avail < len)
        return probe_more();
    if (p[len - 1] != END)
        return probe_reject(CANSER_REJECT_END);
    store_frame(frame, id, (unsigned)ext, rtr, 0, dlc, p + header);
    return probe_frame(len);
}

CANSER_COLD probe_result probe_remote(const uint8_t *p, size_t avail, canser_frame *frame)
{
    return probe_rest(p, avail, frame, true);
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    (void)raw;
    if (p[0] != START)
        return probe_reject(CANSER_REJECT_MARKER);
    if (avail < 2)
        return probe_more();
    const unsigned type = p[1];
    if (!CANSER_LIKELY((type & TYPE_MARK) == TYPE_MARK)) {
        if (type != FIXED)
            return probe_reject(CANSER_REJECT_TYPE);
        return avail < FIXED_LEN ? probe_more() : probe_fixed(p, frame);
    }
    if ((type & TYPE_DLC) > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);
    if (!CANSER_LIKELY(!(type & TYPE_RTR)))
        return probe_remote(p, avail, frame);
    return probe_rest(p, avail, frame, false);
}

CANSER_INLINE int refuse(const canser_frame *frame)
{
    return refuse_frame(frame, true, false);
}

CANSER_INLINE unsigned emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    static const uint8_t zeros[DLC_MAX];
    const unsigned ext = frame->ext != 0, rtr = frame->rtr != 0;
    const unsigned header = 4 + 2 * ext;
    (void)raw;
    out[0] = START;
    out[1] = (uint8_t)(TYPE_MARK | ext << 5 | rtr << 4 | frame->dlc);
    store_le32(out + 2, frame->id); /* of a standard id two bytes are overwritten below */
    memcpy(out + header, rtr ? zeros : frame->data, DLC_MAX);
    out[header + frame->dlc] = END;
    return header + frame->dlc + 1;
}

#define HAS_CLOCK 0
#include "scan.h"

static const struct canser_codec codec = {scan, encode};

const canser_protocol canser_protocol_seeed = {
    .name = "seeed",
    .aliases = "seeedstudio waveshare",
    .frame_min = 5,
    .frame_max = 6 + DLC_MAX + 1,
    .has_clock = HAS_CLOCK,
    .codec = &codec,
};
