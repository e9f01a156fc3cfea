/* Private: the functions behind a row of the list of protocols, and helpers of all
 * wire formats: loads and stores in a fixed byte order, payload masks. */
#ifndef CANSER_PROTOCOL_H
#define CANSER_PROTOCOL_H

#include "canser.h"

#include <stdbool.h>
#include <string.h>

#define CANSER_DECLARE(name, packet_max) extern const canser_protocol canser_protocol_##name;
CANSER_PROTOCOLS(CANSER_DECLARE)
#undef CANSER_DECLARE

/* Compiler extensions, one macro each. */
#if defined(__GNUC__)
#define CANSER_INLINE            static inline __attribute__((always_inline))
#define CANSER_NOINLINE          static __attribute__((noinline))
#define CANSER_COLD              static __attribute__((noinline, cold))
#define CANSER_LIKELY(x)         __builtin_expect(!!(x), 1)
#define CANSER_PREFETCH_READ(p)  __builtin_prefetch((p), 0)
#define CANSER_PREFETCH_WRITE(p) __builtin_prefetch((p), 1)
/* Hides a value from the compiler, which keeps a sum in the order in which it is
 * written. */
#define CANSER_OPAQUE(x) __asm__("" : "+r"(x))
/* Atomic, and a full barrier: if `*p`, of 32 bits, is `from`, set it to `to` and return true. */
#define CANSER_COMPARE_EXCHANGE(p, from, to) __sync_bool_compare_and_swap((p), (from), (to))
/* Atomic, and a full barrier: add `n` to `*p`, of 32 bits, and return the sum. */
#define CANSER_ADD(p, n) __sync_add_and_fetch((p), (uint32_t)(n))
#elif defined(_MSC_VER)
#include <intrin.h>
#define CANSER_COMPARE_EXCHANGE(p, from, to)                                                       \
    (_InterlockedCompareExchange((volatile long *)(p), (long)(to), (long)(from)) == (long)(from))
#define CANSER_ADD(p, n)                                                                           \
    ((uint32_t)_InterlockedExchangeAdd((volatile long *)(p), (long)(n)) + (uint32_t)(n))
#define CANSER_INLINE            static __forceinline
#define CANSER_NOINLINE          static __declspec(noinline)
#define CANSER_COLD              static __declspec(noinline)
#define CANSER_LIKELY(x)         (x)
#define CANSER_PREFETCH_READ(p)  ((void)(p))
#define CANSER_PREFETCH_WRITE(p) ((void)(p))
#define CANSER_OPAQUE(x)         ((void)(x))
#else
#define CANSER_INLINE            static inline
#define CANSER_NOINLINE          static
#define CANSER_COLD              static
#define CANSER_LIKELY(x)         (x)
#define CANSER_PREFETCH_READ(p)  ((void)(p))
#define CANSER_PREFETCH_WRITE(p) ((void)(p))
#define CANSER_OPAQUE(x)         ((void)(x))
#endif

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ == __ORDER_BIG_ENDIAN__
#define CANSER_BIG_ENDIAN 1
#else
#define CANSER_BIG_ENDIAN 0
#endif

/* Limits of CAN 2.0 (ISO 11898-1). */
enum { DLC_MAX = 8, ID_STD_MAX = 0x7FF, ID_EXT_MAX = 0x1FFFFFFF };

/* The treatment of the end of the input. */
typedef enum {
    SCAN_BODY, /* every position has a whole window behind it */
    SCAN_EDGE, /* a candidate that lacks bytes waits for them */
    SCAN_END   /* a candidate that lacks bytes is a reject: the stream has ended */
} scan_mode;

/* The place at which a scan stopped: its end, a full array, or a lack of bytes. */
typedef struct {
    size_t pos;
    bool wants_more;
} scan_stop;

/* The number of bytes that may be read behind any candidate: bytes of the stream, or
 * padding. */
enum { SCAN_WINDOW = CANSER_BEHIND };

/* The result of a probe at one position. */
typedef enum { PROBE_FRAME, PROBE_CONTROL, PROBE_MORE, PROBE_REJECT } probe_kind;

typedef struct {
    probe_kind kind;
    size_t value; /* the packet's length, or the reason of the reject */
} probe_result;

CANSER_INLINE probe_result probe_frame(size_t len)
{
    return (probe_result){PROBE_FRAME, len};
}

CANSER_INLINE probe_result probe_control(size_t len)
{
    return (probe_result){PROBE_CONTROL, len};
}

CANSER_INLINE probe_result probe_more(void)
{
    return (probe_result){PROBE_MORE, 0};
}

CANSER_INLINE probe_result probe_reject(size_t reason)
{
    return (probe_result){PROBE_REJECT, reason};
}

/* The functions of a wire format. */
struct canser_codec {
    /* Take the packets that start in data[pos..stop); `len` bytes are the
     * stream's, and SCAN_WINDOW bytes are readable behind each position before
     * `stop`. `base` is the stream offset of data[0]. Appends to the batch and
     * adds to the decoder's clock and counters, all but bytes_in. */
    scan_stop (*scan)(canser_decoder *self, const uint8_t *data, size_t pos, size_t stop,
                      size_t len, uint64_t base, canser_batch *batch, scan_mode mode);
    /* Encode frames one behind the other, until one is refused or fewer than
     * SCAN_WINDOW bytes are left in `out`. */
    void (*encode)(const canser_frame *frames, size_t frame_count, int64_t tick_ns, uint8_t *out,
                   size_t out_cap, canser_encoded *result);
    /* Return why the format cannot carry a frame: CANSER_REFUSAL_*, NONE if it can. */
    int (*refuse)(const canser_frame *frame);
    /* Write the configuration packet: all values are in range, and the bit rate is
     * bitrates[rate]. NULL if the row has no bit rates. */
    void (*configure)(const canser_config *config, size_t rate, canser_packet *packet);
    /* Find the meaning of one whole control packet, in a report that is all zero before. NULL
     * if the format has no control packets. */
    void (*explain)(const uint8_t *packet, canser_report *report);
};

CANSER_INLINE bool misaligned(const void *p, size_t alignment)
{
    return (uintptr_t)p % alignment != 0;
}

/* A range of memory, for the check whether two of them overlap. */
typedef struct {
    uintptr_t begin, end;
} span;

CANSER_INLINE span span_of(const void *p, size_t count, size_t size)
{
    const uintptr_t begin = (uintptr_t)p;
    return (span){begin, p ? begin + count * size : begin};
}

CANSER_INLINE bool spans_meet(span a, span b)
{
    return a.begin < b.end && b.begin < a.end;
}

CANSER_INLINE uint32_t load_le16(const uint8_t *p)
{
    return (uint32_t)p[0] | (uint32_t)p[1] << 8;
}

CANSER_INLINE uint32_t load_le32(const uint8_t *p)
{
#if CANSER_BIG_ENDIAN
    return load_le16(p) | load_le16(p + 2) << 16;
#else
    uint32_t value;
    memcpy(&value, p, sizeof value);
    return value;
#endif
}

CANSER_INLINE void store_le32(uint8_t *p, uint32_t value)
{
#if CANSER_BIG_ENDIAN
    for (int i = 0; i < 4; i++)
        p[i] = (uint8_t)(value >> 8 * i);
#else
    memcpy(p, &value, sizeof value);
#endif
}

/* How far a product of `bits` bits is shifted right to be a place in an open hash of `cap` places,
 * a power of two: its upper bits depend on all bits of the key. */
CANSER_INLINE unsigned place_shift(size_t cap, unsigned bits)
{
    for (; cap > 1; cap >>= 1)
        bits--;
    return bits;
}

/* Eight bytes as they lie in memory. */
CANSER_INLINE uint64_t load_word(const uint8_t *p)
{
    uint64_t word;
    memcpy(&word, p, sizeof word);
    return word;
}

/* Store a record without its time as two words of eight bytes: a store for each field
 * takes longer than the payload. */
CANSER_INLINE void store_words(canser_frame *frame, uint64_t head, uint64_t payload)
{
    memcpy(frame, &head, sizeof head);
    memcpy(frame->data, &payload, sizeof payload);
}

/* The mask of a word's first `count` bytes in memory, constant. */
#if CANSER_BIG_ENDIAN
#define FIRST_BYTES(count) (~(UINT64_MAX >> 4 * (count) >> 4 * (count)))
#else
#define FIRST_BYTES(count) (~(UINT64_MAX << 4 * (count) << 4 * (count)))
#endif

/* Load the first `dlc` of eight bytes, the rest zero, by a table and one wide load: a
 * memcpy of variable length is ten times slower. */
CANSER_INLINE uint64_t load_payload(const uint8_t *p, size_t dlc)
{
    static const uint64_t keep[DLC_MAX + 1] = {
        FIRST_BYTES(0), FIRST_BYTES(1), FIRST_BYTES(2), FIRST_BYTES(3), FIRST_BYTES(4),
        FIRST_BYTES(5), FIRST_BYTES(6), FIRST_BYTES(7), FIRST_BYTES(8),
    };
    return load_word(p) & keep[dlc];
}

/* id, ext, rtr, err and dlc as one word, in the order of the record. */
#if CANSER_BIG_ENDIAN
#define FRAME_HEAD(id, ext, rtr, err, dlc)                                                         \
    ((uint64_t)(id) << 32 | (uint64_t)(ext) << 24 | (uint64_t)(rtr) << 16 | (uint64_t)(dlc) << 8 | \
     (uint64_t)(err))
#else
#define FRAME_HEAD(id, ext, rtr, err, dlc)                                                         \
    ((uint64_t)(id) | (uint64_t)(ext) << 32 | (uint64_t)(rtr) << 40 | (uint64_t)(dlc) << 48 |      \
     (uint64_t)(err) << 56)
#endif

/* Store all fields of a record but its time. */
CANSER_INLINE void store_frame(canser_frame *frame, uint32_t id, unsigned ext, unsigned rtr,
                               unsigned err, size_t dlc, const uint8_t *payload)
{
    store_words(frame, FRAME_HEAD(id, ext, rtr, err, dlc),
                load_payload(payload, dlc & ((size_t)rtr - 1)));
}

/* Return why the format cannot carry a frame: a dlc over 8, an id over the limit of its
 * kind, or a kind that it does not have. */
CANSER_INLINE int refuse_frame(const canser_frame *frame, bool has_ext, bool has_err)
{
    const bool ext = frame->ext != 0;

    if (frame->err && !has_err)
        return CANSER_REFUSAL_ERR;
    if (ext && !has_ext)
        return CANSER_REFUSAL_EXT;
    if (frame->dlc > DLC_MAX)
        return CANSER_REFUSAL_DLC;
    if (frame->id > (uint32_t)(ext ? ID_EXT_MAX : ID_STD_MAX))
        return ext ? CANSER_REFUSAL_ID_EXT : CANSER_REFUSAL_ID;
    return CANSER_REFUSAL_NONE;
}

/* The parts of a data frame that may be sent. */
typedef struct {
    uint32_t id;
    uint32_t ext; /* 0 or 1 */
    size_t dlc;
    size_t kind; /* twice the dlc and ext: a row of a table */
} plain_frame;

enum { PLAIN_KINDS = 2 * 16 };

/* Whether a frame is a data frame that may be sent; if so, its parts. Its kind selects the bits
 * that no head of this kind has, so that one test is enough: a test for each rule would take
 * a third of the time, and a branch on ext is mispredicted on mixed traffic. An ext or a dlc
 * that is too large selects any kind: their upper bits are among the bits of each. */
CANSER_INLINE bool take_apart(const canser_frame *frame, bool has_ext, plain_frame *plain)
{
#define OVER(id_max, ext_over) FRAME_HEAD(~(uint32_t)(id_max), ext_over, 0xFF, 0xFF, 0xF0)
#define OVER_KINDS             OVER(ID_STD_MAX, 0xFF), OVER(ID_EXT_MAX, 0xFE)
#define OVER_DLC               UINT64_MAX, UINT64_MAX
    static const uint64_t over[PLAIN_KINDS] = {
        OVER_KINDS, OVER_KINDS, OVER_KINDS, OVER_KINDS, OVER_KINDS, OVER_KINDS,
        OVER_KINDS, OVER_KINDS, OVER_KINDS, OVER_DLC,   OVER_DLC,   OVER_DLC,
        OVER_DLC,   OVER_DLC,   OVER_DLC,   OVER_DLC,
    };
    uint64_t head;

    memcpy(&head, frame, sizeof head);
    plain->id = CANSER_BIG_ENDIAN ? (uint32_t)(head >> 32) : (uint32_t)head;
    plain->ext = has_ext ? frame->ext : 0;
    plain->dlc = frame->dlc;
    plain->kind = (2 * plain->dlc + plain->ext) % PLAIN_KINDS;
    return CANSER_LIKELY(!(head & over[plain->kind]));
}

#endif
