/* cantalope: the CANtalope of the Portland State Aerospace Society.
 *
 *     id[10..3] | id[2..0] rtr dlc[3..0] | payload, dlc bytes
 *      0          1                        2
 *
 *     FF FF | 00               ping, 3 bytes: comes straight back
 *     FF FF | 01 | number      error report, 4 bytes
 *
 * Source: "CANtalope Serial Protocol", CAN messages and Command/Status messages.
 *
 * Known ambiguities:
 * - Nothing marks a frame's start: after a lost byte wrong frames come out until
 *   the chain falls back into step. The ping is the only check there is.
 * - Payload follows by the dlc in remote frames, too ("we use the DLC to
 *   calculate at what point a new serial packet should be coming").
 * - Commands other than 00 and 01 have lengths that nobody wrote down: rejected.
 * - Standard ids only, no error frames, no timestamp.
 */
#include "protocol.h"

enum { HEADER = 2, COMMAND = 0xFF, PING = 0x00, PING_LEN = 3, ERROR_REPORT = 0x01, ERROR_LEN = 4 };

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    (void)raw;
    if (avail < HEADER)
        return probe_more();
    const size_t dlc = p[1] & 0xF;
    if (!CANSER_LIKELY(dlc <= DLC_MAX)) {
        if (p[0] != COMMAND || p[1] != COMMAND)
            return probe_reject(CANSER_REJECT_DLC);
        if (avail < HEADER + 1)
            return probe_more();
        if (p[2] == PING)
            return probe_control(PING_LEN);
        if (p[2] != ERROR_REPORT)
            return probe_reject(CANSER_REJECT_COMMAND);
        return avail < ERROR_LEN ? probe_more() : probe_control(ERROR_LEN);
    }
    const size_t len = HEADER + dlc;
    if (avail < len)
        return probe_more();
    store_frame(frame, (uint32_t)p[0] << 3 | p[1] >> 5, 0, p[1] >> 4 & 1, 0, dlc, p + HEADER);
    return probe_frame(len);
}

CANSER_INLINE int refuse(const canser_frame *frame)
{
    return refuse_frame(frame, false, false);
}

CANSER_INLINE unsigned emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    static const uint8_t zeros[DLC_MAX];
    const unsigned head = (unsigned)frame->id << 5 | (frame->rtr ? 1u << 4 : 0) | frame->dlc;
    (void)raw;
    out[0] = (uint8_t)(head >> 8);
    out[1] = (uint8_t)head;
    memcpy(out + HEADER, frame->rtr ? zeros : frame->data, DLC_MAX);
    return HEADER + frame->dlc;
}

#define HAS_CLOCK 0
#include "scan.h"

static const struct canser_codec codec = {scan, encode};

const canser_protocol canser_protocol_cantalope = {
    .name = "cantalope",
    .aliases = "",
    .frame_min = HEADER,
    .frame_max = HEADER + DLC_MAX,
    .has_clock = HAS_CLOCK,
    .codec = &codec,
};
