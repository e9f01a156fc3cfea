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
 *     AA 55 01 | 1 std, 2 ext | 1 data, 2 remote | id u32 LE | dlc | data[8] | any | sum
 *      0         3              4                  5           9     10        18    19
 *
 *     command 04 asks for the status, and is the status that comes back:
 *     AA 55 04 | receive errors | transmit errors | 00 * 14 | sum
 *      0         3                4                 5         19
 *
 *     command 12 or 02 configures the adapter, which then reports frames in packets of
 *     variable (12) or fixed (02) length; let it settle for 100 ms:
 *     AA 55 12 | bitrate | kinds | filter u32 LE | mask u32 LE | mode | once | 00 * 4 | sum
 *      0         3         4       5               9             13     14     15       19
 *     bitrate: 01..0C, the places in `bitrates` below; kinds: 1 both, 2 extended only;
 *     mode: 0 normal, 1 loopback, 2 silent, 3 both; once: 1 no retransmission
 *
 * Source: Seeed's "Serial port (USB) to CAN protocol definition"; Waveshare's
 * protocol of the USB-CAN-A for the fixed packets; python-can 4.6 for the status.
 *
 * Known ambiguities:
 * - The document's remark that in E2 bit 5 is 0 is a slip: it is 1, extended.
 * - Remote frames: the device fills dlc bytes with anything, python-can writes
 *   none. If the byte behind the id is the end mark the frame ends there, else
 *   dlc bytes later. Written with dlc zero bytes, as the device expects.
 * - AA and 55 inside ids and payloads are normal.
 * - Byte 18 of a fixed frame is reserved: the documents write 0, any value is accepted
 *   here, for the sum guards it.
 * - There is no timestamp.
 * - Of the modes Waveshare's page says 1 silent, 2 loopback; the programs that work
 *   with real adapters have it as above.
 * - The four zeros of a configuration are a "manual bitrate config, details unknown" to
 *   python-can: where they are not zero, the configuration is unknown.
 */
#include "protocol.h"

enum { START = 0xAA, END = 0x55, LEAD = 1, FIXED = 0x55, FIXED_LEN = 20, FIXED_FRAME = 0x01 };
enum {
    TYPE_MARK = 0xC0,
    MARK_NIBBLE = TYPE_MARK >> 4,
    TYPE_EXT = 0x20,
    TYPE_RTR = 0x10,
    TYPE_DLC = 0x0F
};

/* The end mark of a data frame is looked at before its dlc is known to be good. */
_Static_assert(6 + TYPE_DLC + 1 <= SCAN_WINDOW, "the longest length a type byte can claim");

/* Return the checksum of a fixed packet, its last byte. */
CANSER_INLINE uint8_t fixed_sum(const uint8_t *p)
{
    unsigned sum = 0;
    for (int i = 2; i < FIXED_LEN - 1; i++)
        sum += p[i];
    return (uint8_t)sum;
}

CANSER_NOINLINE probe_result probe_fixed(const uint8_t *p, canser_frame *frame)
{
    if (fixed_sum(p) != p[FIXED_LEN - 1])
        return probe_reject(CANSER_REJECT_SUM);
    if (p[2] != FIXED_FRAME)
        return probe_control(FIXED_LEN);

    const bool ext = p[3] == 2, rtr = p[4] == 2;
    const uint32_t id = load_le32(p + 5);
    const unsigned dlc = p[9];
    if ((p[3] != 1 && !ext) || (p[4] != 1 && !rtr) || dlc > DLC_MAX ||
        id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return probe_reject(CANSER_REJECT_FIELD);
    store_frame(frame, id, ext, rtr, 0, dlc, p + 10);
    return probe_frame(FIXED_LEN);
}

/* Probe byte by byte behind the start mark: packets that are no plain data frames, and the reasons
 * of rejects. */
CANSER_NOINLINE probe_result probe_started(const uint8_t *p, size_t avail, canser_frame *frame)
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
    return p[0] == START ? probe_started(p, avail, frame) : probe_reject(CANSER_REJECT_MARKER);
}

/* The meaning of a type byte, without its mark, for a data frame: one row instead of a test for
 * each rule. Tests and shifts share two ports of the CPU: with all of them a frame would take
 * longer than the access to memory. And a branch on the kind of the id is mispredicted on mixed
 * traffic. */
typedef struct {
    uint64_t flags;   /* ext and dlc, at their places in the record */
    uint64_t payload; /* mask of the payload's bytes */
    uint32_t id;      /* mask of the id's bytes */
    uint32_t id_over; /* bits that no id has */
    uint32_t end;     /* the end mark; a value that no byte has if no data frame has this type */
} data_kind;

#define KIND(dlc, ext, id, id_max)                                                                 \
    {FRAME_HEAD(0, ext, 0, 0, dlc), FIRST_BYTES(dlc), id, (id) & ~(id_max), END}
#define KINDS(ext, id, id_max)                                                                     \
    KIND(0, ext, id, id_max), KIND(1, ext, id, id_max), KIND(2, ext, id, id_max),                  \
        KIND(3, ext, id, id_max), KIND(4, ext, id, id_max), KIND(5, ext, id, id_max),              \
        KIND(6, ext, id, id_max), KIND(7, ext, id, id_max), KIND(8, ext, id, id_max)
#define NONE   {0, 0, 0, 0, 0x100}
#define NONE_8 NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE

/* clang-format off */
static const data_kind data_kinds[] = {
    KINDS(0, UINT32_C(0xFFFF), (uint32_t)ID_STD_MAX),
    NONE, NONE, NONE, NONE, NONE, NONE, NONE, /* a dlc over 8 */
    NONE_8, NONE_8,                           /* remote frames */
    KINDS(1, UINT32_C(0xFFFFFFFF), (uint32_t)ID_EXT_MAX),
};
/* clang-format on */

CANSER_INLINE bool begin_plain(const uint8_t *p, size_t *lead)
{
    *lead = p[LEAD];
    return true;
}

CANSER_INLINE bool probe_plain(const uint8_t **p, size_t *lead, canser_frame *frame, uint32_t *raw)
{
    const uint8_t *const begin = *p;
    const size_t type = *lead;
    const size_t kind_at = type ^ TYPE_MARK;
    const size_t nibble = type >> 4; /* the mark, and 2 for the two more bytes of an extended id */

    (void)raw;
    if (!CANSER_LIKELY(kind_at < sizeof data_kinds / sizeof *data_kinds) ||
        !CANSER_LIKELY(begin[0] == START))
        return false;
    const data_kind *const kind = &data_kinds[kind_at];
    const uint32_t id = load_le32(begin + 2);
    const uint64_t payload = load_word(begin + (nibble - (MARK_NIBBLE - 4)));
    /* So the next frame waits for a mask, a sum and a load only. */
    const uint8_t *ahead =
        (const uint8_t *)((uintptr_t)begin - (MARK_NIBBLE - 5 - LEAD) + (type & TYPE_DLC));
    CANSER_OPAQUE(ahead);
    *lead = ahead[nibble];
    CANSER_OPAQUE(ahead);
    const unsigned end = ahead[(ptrdiff_t)nibble - LEAD - 1];
    if (!CANSER_LIKELY(!((id & kind->id_over) | (end ^ kind->end))))
        return false;
    *p = ahead + nibble - LEAD;
    store_words(frame, FRAME_HEAD(id & kind->id, 0, 0, 0, 0) | kind->flags,
                payload & kind->payload);
    return true;
}

/* `lead` is the start mark and the type, in one store: with two stores a frame takes a tenth
 * longer. */
CANSER_INLINE uint8_t *emit_fields(const uint8_t *lead, uint32_t id, size_t ext, size_t dlc,
                                   const uint8_t *payload, uint8_t *out)
{
    memcpy(out, lead, 2);
    store_le32(out + 2, id); /* the upper two bytes of a standard id are overwritten below */
    out += 2 * ext;
    memcpy(out + 4, payload, DLC_MAX); /* the end mark overwrites the surplus */
    out += dlc;
    out[4] = END;
    return out + 5;
}

CANSER_INLINE uint8_t *emit_plain(const plain_frame *plain, uint32_t raw, const uint8_t *payload,
                                  uint8_t *out)
{
#define KIND_LEAD(ext, dlc) {START, TYPE_MARK | (ext) | (dlc)}
#define KIND_LEADS(dlc)     KIND_LEAD(0, dlc), KIND_LEAD(TYPE_EXT, dlc)
    static const uint8_t leads[PLAIN_KINDS][2] = {
        KIND_LEADS(0), KIND_LEADS(1), KIND_LEADS(2), KIND_LEADS(3), KIND_LEADS(4),
        KIND_LEADS(5), KIND_LEADS(6), KIND_LEADS(7), KIND_LEADS(8),
    };

    (void)raw;
    return emit_fields(leads[plain->kind], plain->id, plain->ext, plain->dlc, payload, out);
}

CANSER_INLINE uint8_t *emit(const canser_frame *frame, uint32_t raw, uint8_t *out)
{
    static const uint8_t zeros[DLC_MAX];
    const unsigned ext = frame->ext != 0, rtr = frame->rtr != 0;
    const uint8_t lead[2] = {START, (uint8_t)(TYPE_MARK | ext << 5 | rtr << 4 | frame->dlc)};

    (void)raw;
    return emit_fields(lead, frame->id, ext, frame->dlc, rtr ? zeros : frame->data, out);
}

#define NAME       seeed
#define START_MARK START
#define HAS_CLOCK  0
#define HAS_EXT    1
#define HAS_ERR    0
#define HAS_PLAIN  1
#define FRAME_MIN  5
#define FRAME_MAX  FIXED_LEN
#define PACKET_MAX FIXED_LEN
#include "scan.h"

/* Commands of control packets. */
enum { STATUS = 0x04, CONFIGURE = 0x12, CONFIGURE_FIXED = 0x02 };

enum { KINDS_ALL = 1, KINDS_EXT = 2, RATES = 12, RATE_FIRST = 1 };

static const uint32_t bitrates[RATES + 1] = {1000000, 800000, 500000, 400000, 250000, 200000,
                                             125000,  100000, 50000,  20000,  10000,  5000};

_Static_assert(CANSER_MODE_NORMAL == 0 && CANSER_MODE_LOOPBACK == 1 && CANSER_MODE_SILENT == 2 &&
                   CANSER_MODE_LOOPBACK_SILENT == 3,
               "the modes are the wire's");

static void configure(const canser_config *config, size_t rate, canser_packet *packet)
{
    uint8_t *const p = packet->bytes;

    packet->len = FIXED_LEN;
    p[0] = START;
    p[1] = FIXED;
    p[2] = config->fixed ? CONFIGURE_FIXED : CONFIGURE;
    p[3] = (uint8_t)(RATE_FIRST + rate);
    p[4] = config->ext_only ? KINDS_EXT : KINDS_ALL;
    store_le32(p + 5, config->filter_id);
    store_le32(p + 9, config->filter_mask);
    p[13] = config->mode;
    p[14] = config->once != 0;
    p[FIXED_LEN - 1] = fixed_sum(p);
}

static void explain(const uint8_t *p, canser_report *report)
{
    if (p[2] == STATUS) {
        report->kind = CANSER_CONTROL_STATUS;
        report->receive_errors = p[3];
        report->transmit_errors = p[4];
        return;
    }
    if ((p[2] != CONFIGURE && p[2] != CONFIGURE_FIXED) || p[3] < RATE_FIRST ||
        p[3] >= RATE_FIRST + RATES || (p[4] != KINDS_ALL && p[4] != KINDS_EXT) ||
        p[13] >= CANSER_MODE_COUNT || p[14] > 1 || load_le32(p + 15) != 0)
        return;
    report->kind = CANSER_CONTROL_CONFIGURATION;
    report->config = (canser_config){
        .bitrate = bitrates[p[3] - RATE_FIRST],
        .filter_id = load_le32(p + 5),
        .filter_mask = load_le32(p + 9),
        .mode = p[13],
        .ext_only = p[4] == KINDS_EXT,
        .once = p[14],
        .fixed = p[2] == CONFIGURE_FIXED,
    };
}

static const struct canser_codec codec = {
    .scan = scan, .encode = encode, .refuse = refuse, .configure = configure, .explain = explain};

const canser_protocol canser_protocol_seeed = {
    .name = "seeed",
    .aliases = "seeedstudio waveshare",
    .frame_min = FRAME_MIN,
    .frame_max = 6 + DLC_MAX + 1,
    .has_clock = HAS_CLOCK,
    .baudrate = 2000000,
    .bitrates = bitrates,
    /* The sum is that of the command alone. */
    .status_request = {FIXED_LEN, {START, FIXED, STATUS, [FIXED_LEN - 1] = STATUS}},
    .codec = &codec,
};
