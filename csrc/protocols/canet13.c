/* canet13: 13 bytes a frame, of converters from CAN to Ethernet or a serial line.
 *
 *     info | id u32 BE | data, 8 bytes
 *      0      1           5
 *
 *     info: bit 7 extended, bit 6 remote, bits 5 and 4 zero, bits 3..0 dlc
 *
 * Source: the manuals of USR-CANET200, EByte E810-DTU and ECAN, and Waveshare 2-CH-CAN-TO-ETH:
 * "CAN frame format" of the transparent mode with 13 bytes.
 *
 * Known ambiguities:
 * - Nothing marks a frame's start, and there is no checksum: after a lost byte wrong frames come
 *   out until the scan falls back into step. Over TCP no byte is lost.
 * - The manuals' examples have zeros behind the dlc, and do not ask for them: anything may stand
 *   there, and is not part of the frame. Written as zeros.
 * - Remote frames have 8 bytes of data, too, which mean nothing.
 * - No error frames, no timestamp, no control packets. Heartbeats and registration texts are what
 *   a user of the converter has entered: they are skipped.
 */
#include "protocol.h"

enum { LEN = 13, ID_AT = 1, DATA_AT = 5 };
enum { INFO_EXT = 0x80, INFO_RTR = 0x40, INFO_ZERO = 0x30, INFO_DLC = 0x0F };

CANSER_INLINE uint32_t load_be32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    const unsigned info = p[0], dlc = info & INFO_DLC;
    const unsigned ext = info >> 7, rtr = info >> 6 & 1;

    (void)raw;
    if (info & INFO_ZERO)
        return probe_reject(CANSER_REJECT_TYPE);
    if (dlc > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);
    if (avail < DATA_AT)
        return probe_more();
    const uint32_t id = load_be32(p + ID_AT);
    if (id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return probe_reject(CANSER_REJECT_ID);
    if (avail < LEN)
        return probe_more();
    store_frame(frame, id, ext, rtr, 0, dlc, p + DATA_AT);
    return probe_frame(LEN);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    const unsigned ext = frame->ext != 0, rtr = frame->rtr != 0;
    const uint64_t data = load_payload(frame->data, rtr ? 0 : frame->dlc);

    (void)raw;
    out[0] = (uint8_t)(ext << 7 | rtr << 6 | frame->dlc);
    for (int i = 0; i < 4; i++)
        out[ID_AT + i] = (uint8_t)(frame->id >> (24 - 8 * i));
    memcpy(out + DATA_AT, &data, sizeof data);
    return out + LEN;
}

#define NAME       canet13
#define HAS_CLOCK  0
#define HAS_EXT    1
#define HAS_ERR    0
#define HAS_PLAIN  0
#define FRAME_MIN  LEN
#define FRAME_MAX  LEN
#define PACKET_MAX LEN
#include "scan.h"

static const struct canser_codec codec = {.scan = scan, .encode = encode, .refuse = refuse};

const canser_protocol canser_protocol_canet13 = {
    .name = "canet13",
    .aliases = "",
    .frame_min = LEN,
    .frame_max = LEN,
    .has_clock = HAS_CLOCK,
    .baudrate = 115200,
    .codec = &codec,
};
