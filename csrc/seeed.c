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
enum { TYPE_MARK = 0xC0, TYPE_EXT = 0x20, TYPE_RTR = 0x10, TYPE_DLC = 0x0F };

/* The first two bytes of a data frame, as a little-endian number. */
enum { DATA_MASK = (TYPE_MARK | TYPE_RTR) << 8 | 0xFF, DATA_HEAD = TYPE_MARK << 8 | START };

/* The end mark of a data frame is looked at before its dlc is known to be good. */
_Static_assert(6 + TYPE_DLC + 1 <= SCAN_WINDOW, "the longest length a type byte can claim");

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

/* Everything but the start mark, byte by byte: what is no plain data frame, and
 * why nothing starts here. */
CANSER_COLD probe_result probe_each(const uint8_t *p, size_t avail, canser_frame *frame)
{
    if (avail < 2)
        return probe_more();
    const unsigned type = p[1];
    if (type == FIXED)
        return avail < FIXED_LEN ? probe_more() : probe_fixed(p, frame);
    if ((type & TYPE_MARK) != TYPE_MARK)
        return probe_reject(CANSER_REJECT_TYPE);
    const unsigned dlc = type & TYPE_DLC;
    if (dlc > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);

    const bool ext = type & TYPE_EXT, rtr = type & TYPE_RTR;
    const size_t header = ext ? 6 : 4;
    if (avail < header)
        return probe_more();
    const uint32_t id = ext ? load_le32(p + 2) : load_le16(p + 2);
    if (id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return probe_reject(CANSER_REJECT_ID);

    if (avail < header + 1)
        return probe_more();
    const size_t len = rtr && p[header] == END ? header + 1 : header + dlc + 1;
    if (avail < len)
        return probe_more();
    if (p[len - 1] != END)
        return probe_reject(CANSER_REJECT_END);
    store_frame(frame, id, ext, rtr, 0, dlc, p + header);
    return probe_frame(len);
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    (void)raw;
    /* A whole data frame in two tests. Branches and shifts share two ports of the
     * CPU, and with a test for each rule they take longer than the memory; nor can
     * anybody predict the kind of the id on mixed traffic. */
    if (avail >= SCAN_WINDOW && CANSER_LIKELY((load_le16(p) & DATA_MASK) == DATA_HEAD)) {
        const size_t dlc = p[1] & TYPE_DLC;
        const size_t more = p[1] >> 4 & 2; /* bytes that an extended id has more */
        const size_t len = dlc + 5 + more;
        const int64_t wide = -(int64_t)(more >> 1);
        const int64_t id = load_le32(p + 2) & (wide | 0xFFFF);
        const int64_t id_max = ID_STD_MAX | (wide & ID_EXT_MAX);
        /* Negative if any of the three is. */
        const int64_t good =
            (id_max - id) | (DLC_MAX - (int64_t)dlc) | -(int64_t)(p[len - 1] ^ END);

        if (CANSER_LIKELY(good >= 0)) {
            store_frame(frame, (uint32_t)id, (unsigned)more >> 1, 0, 0, dlc, p + 4 + more);
            return probe_frame(len);
        }
    }
    return p[0] == START ? probe_each(p, avail, frame) : probe_reject(CANSER_REJECT_MARKER);
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
