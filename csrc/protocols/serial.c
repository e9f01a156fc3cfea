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

enum { START = 0xAA, END = 0xBB, LEAD = 5, HEADER = 10 };

/* The flags of the id, by their bits. */
enum { BIT_EXT = 31, BIT_RTR = 30, BIT_ERR = 29 };

/* Flags that hardly any frame has. */
#define FLAGS_RARE (UINT32_C(1) << BIT_RTR | UINT32_C(1) << BIT_ERR)

/* Probe from the id on. `flagged`, a constant in each call, tells whether the remote or the error
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

CANSER_NOINLINE probe_result probe_flagged(const uint8_t *p, size_t avail, canser_frame *frame)
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
    if (!CANSER_LIKELY(!(load_le32(p + 6) & FLAGS_RARE)))
        return probe_flagged(p, avail, frame);
    return probe_rest(p, avail, frame, false);
}

CANSER_INLINE bool begin_plain(const uint8_t *p, size_t *lead)
{
    *lead = p[LEAD];
    return p[0] == START;
}

/* Not for remote and error frames. Any id over 11 bits is extended, and an id with the flag of
 * extended ids is over 11 bits, too. The start mark was checked together with the end mark of the
 * frame before. */
CANSER_INLINE bool probe_plain(const uint8_t **p, size_t *lead, canser_frame *frame, uint32_t *raw)
{
    const uint8_t *const begin = *p;
    const size_t dlc = begin[LEAD];
    const uint32_t id = load_le32(begin + 6);

    (void)lead; /* one sum behind the load: the next frame waits for the dlc */
    *p = begin + HEADER + 1;
    CANSER_OPAQUE(*p);
    *p += dlc;
    if (!CANSER_LIKELY(dlc <= DLC_MAX) || !CANSER_LIKELY(!(id & FLAGS_RARE)) ||
        !CANSER_LIKELY(load_le16(begin + HEADER + dlc) == (END | START << 8)))
        return false;
    *raw = load_le32(begin + 1);
    /* The sum carries into bit 32 for an id over 11 bits: fewer steps than a test. */
    const uint64_t ext = (id + (UINT64_C(1) << 32) - (ID_STD_MAX + 1)) >> 32;
    store_words(frame, FRAME_HEAD(id & ID_EXT_MAX, ext, 0, 0, dlc),
                load_payload(begin + HEADER, dlc));
    return true;
}

/* A store for each field, as shifts to join them take longer. */
CANSER_INLINE uint8_t *emit_fields(uint32_t raw, size_t dlc, uint32_t id, const uint8_t *payload,
                                   size_t payload_len, uint8_t *out)
{
    out[0] = START;
    store_le32(out + 1, raw);
    out[5] = (uint8_t)dlc;
    store_le32(out + 6, id);
    memcpy(out + HEADER, payload, DLC_MAX); /* the end mark overwrites the surplus */
    out += payload_len;
    out[HEADER] = END;
    return out + HEADER + 1;
}

CANSER_INLINE uint8_t *emit_plain(const plain_frame *plain, uint32_t raw, const uint8_t *payload,
                                  uint8_t *out)
{
    return emit_fields(raw, plain->dlc, plain->id | plain->ext << BIT_EXT, payload, plain->dlc,
                       out);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    const uint32_t ext = frame->ext != 0, rtr = frame->rtr != 0, err = frame->err != 0;
    const uint32_t flags = ext << BIT_EXT | rtr << BIT_RTR | err << BIT_ERR;

    return emit_fields(raw, frame->dlc, frame->id | flags, frame->data, rtr ? 0 : frame->dlc, out);
}

#define NAME       serial
#define START_MARK START
#define HAS_CLOCK  1
#define HAS_EXT    1
#define HAS_ERR    1
#define HAS_PLAIN  1
#define FRAME_MIN  (HEADER + 1)
#define FRAME_MAX  (HEADER + DLC_MAX + 1)
#define PACKET_MAX FRAME_MAX
#include "scan.h"

static const struct canser_codec codec = {.scan = scan, .encode = encode, .refuse = refuse};

const canser_protocol canser_protocol_serial = {
    .name = "serial",
    .aliases = "python-can",
    .frame_min = FRAME_MIN,
    .frame_max = FRAME_MAX,
    .has_clock = HAS_CLOCK,
    .baudrate = 115200,
    .codec = &codec,
};
