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
#include "vector.h"

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

/* What the low half of a header, less the id, says of a frame: a row in the place of a test
 * whether it is remote. */
typedef struct {
    uint64_t flags;   /* rtr and dlc, where the record has them */
    uint64_t payload; /* the bytes of the payload */
} header_kind;

#define KIND(dlc, rtr) {FRAME_HEAD(0, 0, rtr, 0, dlc), (rtr) ? 0 : FIRST_BYTES(dlc)}
#define NONE           {0, 0}
#define KINDS(rtr)                                                                                 \
    KIND(0, rtr), KIND(1, rtr), KIND(2, rtr), KIND(3, rtr), KIND(4, rtr), KIND(5, rtr),            \
        KIND(6, rtr), KIND(7, rtr), KIND(8, rtr), NONE, NONE, NONE, NONE, NONE, NONE, NONE

static const header_kind header_kinds[] = {KINDS(0), KINDS(1)};

CANSER_INLINE bool probe_plain(const uint8_t *p, canser_frame *frame, uint32_t *raw,
                               const uint8_t **next)
{
    const size_t low = p[1], dlc = low & 0xF;

    (void)raw;
    *next = p + HEADER;
    CANSER_OPAQUE(*next); /* one sum behind the dlc, which the next frame waits for */
    *next += dlc;
    if (!CANSER_LIKELY(dlc <= DLC_MAX))
        return false;
    const header_kind *const kind = &header_kinds[low & 0x1F];
    const uint32_t id = (uint32_t)p[0] << 3 | (uint32_t)low >> 5;
    store_words(frame, FRAME_HEAD(id, 0, 0, 0, 0) | kind->flags,
                load_word(p + HEADER) & kind->payload);
    return true;
}

#if CANSER_VECTOR

enum { SURVEY_REST = CANSER_REJECT_DLC };

CANSER_INLINE surveyed survey(const uint8_t *p, const bool exact)
{
    (void)exact;
    const uint64_t dlc = survey_at_most(p + 1, 0x0F, DLC_MAX);
    const uint64_t marks = survey_equal(p, COMMAND);
    const uint64_t command = marks & (marks >> 1 | (uint64_t)(p[SURVEY] == COMMAND) << 63);
    const uint64_t known = command ? survey_at_most(p + 2, 0xFF, ERROR_REPORT) : 0;
    return (surveyed){.open = dlc | (command & known), .command = command & ~known};
}

#endif

CANSER_INLINE unsigned emit(const canser_frame *frame, uint32_t raw, uint8_t *out, const bool plain)
{
    static const uint8_t zeros[DLC_MAX];
    const unsigned rtr = !plain && frame->rtr;
    const unsigned head = (unsigned)frame->id << 5 | rtr << 4 | frame->dlc;

    (void)raw;
    out[0] = (uint8_t)(head >> 8);
    out[1] = (uint8_t)head;
    memcpy(out + HEADER, rtr ? zeros : frame->data, DLC_MAX);
    return HEADER + frame->dlc;
}

#define HAS_CLOCK 0
#define HAS_EXT   0
#define HAS_ERR   0
#define FRAME_MIN HEADER
#define FRAME_MAX (HEADER + DLC_MAX)
#include "scan.h"

static const struct canser_codec codec = {scan, encode};

const canser_protocol canser_protocol_cantalope = {
    .name = "cantalope",
    .aliases = "",
    .frame_min = FRAME_MIN,
    .frame_max = FRAME_MAX,
    .has_clock = HAS_CLOCK,
    .codec = &codec,
};
