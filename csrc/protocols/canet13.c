/* canet13: the gateways from CAN to Ethernet and serial of USR, EByte, Waveshare and others.
 *
 *     info | id u32 BE | payload, 8 bytes
 *      0     1           5                    info: ext rtr 0 0 dlc[3..0]
 *
 * The same in both directions; over TCP, UDP or a serial line.
 *
 * Source: the manuals of the USR-CANET200, of EByte's ECAN and E810-DTU, and of Waveshare's
 * 2-CH-CAN-TO-ETH.
 *
 * Known ambiguities:
 * - Nothing marks a frame's start, and there is no checksum: after a lost byte wrong frames come
 *   out, until bytes that start no frame end that. Over TCP no byte is lost.
 * - In the manuals' examples the bytes past the dlc are 0. Any value is accepted; written as 0.
 * - In remote frames, too, 8 bytes follow.
 * - Gateways send texts of the user's own, as sign of life and to register: skipped.
 * - No error frames, no timestamp, no control packets; a web page configures the gateway.
 */
#include "protocol.h"

enum { ID = 1, HEADER = 5, LEN = HEADER + DLC_MAX };

/* The info byte. */
enum { BIT_EXT = 7, BIT_RTR = 6, INFO_ZERO = 0x30, INFO_DLC = 0x0F, INFO_NOT_EXT = 0x7F };

/* The bits that no id has, by ext. */
static const uint32_t id_over[] = {~(uint32_t)ID_STD_MAX, ~(uint32_t)ID_EXT_MAX};

/* Compilers make one instruction of this. */
CANSER_INLINE uint32_t swapped(uint32_t id)
{
    return id << 24 | (id << 8 & 0xFF0000) | (id >> 8 & 0xFF00) | id >> 24;
}

CANSER_INLINE probe_result probe(const uint8_t *p, size_t avail, canser_frame *frame, uint32_t *raw)
{
    const unsigned info = p[0], ext = info >> BIT_EXT;
    const size_t dlc = info & INFO_DLC;

    (void)raw;
    if (info & INFO_ZERO)
        return probe_reject(CANSER_REJECT_TYPE);
    if (dlc > DLC_MAX)
        return probe_reject(CANSER_REJECT_DLC);
    if (avail < HEADER)
        return probe_more();
    const uint32_t id = swapped(load_le32(p + ID));
    if (id & id_over[ext])
        return probe_reject(CANSER_REJECT_ID);
    if (avail < LEN)
        return probe_more();
    store_frame(frame, id, ext, info >> BIT_RTR & 1, 0, dlc, p + HEADER);
    return probe_frame(LEN);
}

/* All frames have one length. */
CANSER_INLINE bool begin_plain(const uint8_t *p, size_t *lead)
{
    (void)p;
    *lead = LEN;
    return true;
}

/* Not for remote frames: with their flag, as with the bits that must be 0, the value tested as dlc
 * is over 8. */
CANSER_INLINE bool probe_plain(const uint8_t **p, size_t *lead, canser_frame *frame, uint32_t *raw)
{
    const uint8_t *const begin = *p;
    const size_t dlc = begin[0] & INFO_NOT_EXT, ext = begin[0] >> BIT_EXT;
    const uint32_t id = swapped(load_le32(begin + ID));

    (void)lead;
    (void)raw;
    if (!CANSER_LIKELY(dlc <= DLC_MAX) || !CANSER_LIKELY(!(id & id_over[ext])))
        return false;
    *p = begin + LEN;
    store_words(frame, FRAME_HEAD(id, ext, 0, 0, dlc), load_payload(begin + HEADER, dlc));
    return true;
}

CANSER_INLINE uint8_t *emit_fields(unsigned info, uint32_t id, uint64_t payload, uint8_t *out)
{
    out[0] = (uint8_t)info;
    store_le32(out + ID, swapped(id));
    memcpy(out + HEADER, &payload, sizeof payload);
    return out + LEN;
}

CANSER_INLINE uint8_t *emit_plain(const plain_frame *plain, uint32_t raw, const uint8_t *payload,
                                  uint8_t *out)
{
    (void)raw;
    return emit_fields((unsigned)(plain->ext << BIT_EXT | plain->dlc), plain->id,
                       load_payload(payload, plain->dlc), out);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    const unsigned ext = frame->ext != 0, rtr = frame->rtr != 0;

    (void)raw;
    return emit_fields(ext << BIT_EXT | rtr << BIT_RTR | frame->dlc, frame->id,
                       load_payload(frame->data, rtr ? 0 : frame->dlc), out);
}

#define NAME       canet13
#define HAS_CLOCK  0
#define HAS_EXT    1
#define HAS_ERR    0
#define HAS_PLAIN  1
#define FRAME_MIN  LEN
#define FRAME_MAX  LEN
#define PACKET_MAX LEN
#include "scan.h"

static const struct canser_codec codec = {.scan = scan, .encode = encode, .refuse = refuse};

const canser_protocol canser_protocol_canet13 = {
    .name = "canet13",
    .aliases = "",
    .frame_min = FRAME_MIN,
    .frame_max = FRAME_MAX,
    .has_clock = HAS_CLOCK,
    .baudrate = 115200,
    .codec = &codec,
};
