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
 * - Commands other than 00 and 01 have lengths that are not documented: rejected.
 * - Standard ids only, no error frames, no timestamp.
 */
#include "protocol.h"

enum {
    LEAD = 1,
    HEADER = 2,
    COMMAND = 0xFF,
    PING = 0x00,
    PING_LEN = 3,
    ERROR_REPORT = 0x01,
    ERROR_LEN = 4
};

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

CANSER_INLINE bool begin_plain(const uint8_t *p, size_t *lead)
{
    *lead = p[LEAD];
    return true;
}

/* Not for remote frames: with their flag, the value tested as dlc is over 8. */
CANSER_INLINE bool probe_plain(const uint8_t **p, size_t *lead, canser_frame *frame, uint32_t *raw)
{
    const uint8_t *const begin = *p, *ahead = begin + HEADER + LEAD;
    const size_t type = *lead, dlc = type & 0x1F;

    (void)raw;
    if (!CANSER_LIKELY(dlc <= DLC_MAX))
        return false;
    CANSER_OPAQUE(ahead); /* so the next frame waits for a mask and a load only */
    *lead = ahead[dlc];
    CANSER_OPAQUE(ahead);
    *p = ahead + dlc - LEAD;
    store_frame(frame, 8 * (uint32_t)begin[0] + (uint32_t)(type >> 5), 0, 0, 0, dlc,
                begin + HEADER);
    return true;
}

CANSER_INLINE uint8_t *emit_fields(uint32_t id, unsigned rtr, size_t dlc, const uint8_t *payload,
                                   uint8_t *out)
{
    const unsigned head = id << 5 | rtr << 4 | (unsigned)dlc;

    out[0] = (uint8_t)(head >> 8);
    out[1] = (uint8_t)head;
    memcpy(out + HEADER, payload, DLC_MAX);
    return out + HEADER + dlc;
}

CANSER_INLINE uint8_t *emit_plain(const plain_frame *plain, uint32_t raw, const uint8_t *payload,
                                  uint8_t *out)
{
    (void)raw;
    return emit_fields(plain->id, 0, plain->dlc, payload, out);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    static const uint8_t zeros[DLC_MAX];
    const unsigned rtr = frame->rtr != 0;

    (void)raw;
    return emit_fields(frame->id, rtr, frame->dlc, rtr ? zeros : frame->data, out);
}

#define NAME       cantalope
#define HAS_CLOCK  0
#define HAS_EXT    0
#define HAS_ERR    0
#define HAS_PLAIN  1
#define FRAME_MIN  HEADER
#define FRAME_MAX  (HEADER + DLC_MAX)
#define PACKET_MAX FRAME_MAX
#include "scan.h"

static void explain(const uint8_t *p, canser_report *report)
{
    if (p[2] == PING) {
        report->kind = CANSER_CONTROL_PING;
    } else {
        report->kind = CANSER_CONTROL_ERROR;
        report->number = p[3];
    }
}

static const struct canser_codec codec = {
    .scan = scan, .encode = encode, .refuse = refuse, .explain = explain};

const canser_protocol canser_protocol_cantalope = {
    .name = "cantalope",
    .aliases = "",
    .frame_min = FRAME_MIN,
    .frame_max = FRAME_MAX,
    .has_clock = HAS_CLOCK,
    .baudrate = 115200,
    .ping = {PING_LEN, {COMMAND, COMMAND, PING}},
    .codec = &codec,
};
