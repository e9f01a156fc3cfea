/* canser: decode and encode the byte streams of serial CAN adapters.
 *
 * Plain C11 without allocation, I/O or globals that change: the caller owns
 * all memory. Return codes tell the caller's mistakes; whatever is wrong on
 * the wire goes to counters. Results are written on every return, errors
 * included, so a count is never stale.
 *
 * The rule of the scan, for every protocol: at each position either a packet
 * starts (take it and go on behind it), or more bytes are needed (they are
 * held until the next call), or none starts (count one skipped byte and go on
 * at the next one). The result does not depend on how the stream was cut.
 *
 * Law: bytes_in == bytes_framed + bytes_control + bytes_skipped + pending.
 *
 * Threads: calls on different decoders may run at the same time; calls on one
 * decoder must not.
 */
#ifndef CANSER_H
#define CANSER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The time of a frame whose time is not known: numpy's NaT. */
#define CANSER_NO_TIME INT64_MIN

/* Between the two cffi lines stands what Python binds, declared only here. */
/* cffi: begin */

/* The longest packet of any protocol, in bytes: the fixed packet of `seeed`. */
#define CANSER_PACKET_MAX 20

/* The bytes that must follow a position for canser_decoder_advance() to decide there. */
#define CANSER_BEHIND 24

/* The frames in which a chunk's clock must settle to be joined. */
#define CANSER_SETTLE_MAX 64

/* Status codes: the caller's mistakes, found before a byte is touched. */
enum {
    CANSER_OK = 0,
    CANSER_NULL = 1,       /* a pointer that must not be NULL is NULL */
    CANSER_MISALIGNED = 2, /* an array does not lie on its element's alignment */
    CANSER_OVERLAP = 3,    /* an output shares bytes with the input or another output */
    CANSER_REFUSED = 4,    /* encode: the format cannot carry a frame */
    CANSER_TICK = 5,       /* tick_ns is less than 1 */
    CANSER_APART = 6       /* join: the chunk does not begin where the stream stands */
};

/* Why no packet starts at a position. One skipped byte is one reject. */
enum {
    CANSER_REJECT_MARKER,  /* the byte is no start mark */
    CANSER_REJECT_TYPE,    /* the type byte is none that the format knows */
    CANSER_REJECT_DLC,     /* the data length code is over 8 */
    CANSER_REJECT_ID,      /* the arbitration id is out of range */
    CANSER_REJECT_END,     /* the end mark is not where it must be */
    CANSER_REJECT_SUM,     /* the checksum does not hold */
    CANSER_REJECT_FIELD,   /* the checksum holds, but a field is out of range */
    CANSER_REJECT_COMMAND, /* a command of unknown length */
    CANSER_REJECT_CUT,     /* the stream ended inside the candidate */
    CANSER_REJECT_COUNT
};

/* Why a format cannot carry a frame. */
enum {
    CANSER_REFUSAL_NONE,
    CANSER_REFUSAL_DLC,    /* dlc over 8 */
    CANSER_REFUSAL_ID,     /* id over 0x7FF without ext */
    CANSER_REFUSAL_ID_EXT, /* id over 0x1FFFFFFF */
    CANSER_REFUSAL_EXT,    /* the format has no extended frames */
    CANSER_REFUSAL_ERR,    /* the format has no error frames */
    CANSER_REFUSAL_TIME,   /* the format needs a time, and the frame has none */
    CANSER_REFUSAL_COUNT
};

/* One decoded frame, 24 bytes: the record of canser.FRAME_DTYPE. */
typedef struct {
    uint32_t id;     /* arbitration id, 11 or 29 bits, no flag bits */
    uint8_t ext;     /* 1: extended (29-bit) frame */
    uint8_t rtr;     /* 1: remote frame */
    uint8_t dlc;     /* data length code, 0..8 */
    uint8_t err;     /* 1: error frame */
    uint8_t data[8]; /* zero past the dlc; all zero in a remote frame */
    int64_t ts;      /* nanoseconds, or CANSER_NO_TIME */
} canser_frame;

/* One packet that is valid but is no CAN frame, 32 bytes. */
typedef struct {
    uint64_t offset;   /* of its first byte in the stream */
    uint8_t len;       /* 1..CANSER_PACKET_MAX */
    uint8_t bytes[23]; /* the packet as it came; zero past len */
} canser_control;

typedef struct {
    uint64_t bytes_in;      /* bytes taken from the caller */
    uint64_t bytes_framed;  /* of these, inside frames */
    uint64_t bytes_control; /* inside control packets */
    uint64_t bytes_skipped; /* inside no packet */
    uint64_t frames;
    uint64_t controls;
    uint64_t resyncs;                      /* unbroken runs of skipped bytes */
    uint64_t rejects[CANSER_REJECT_COUNT]; /* by reason; they add up to bytes_skipped */
    uint64_t ts_wraps;                     /* device clock: steps forward through zero */
    uint64_t ts_backsteps;                 /* device clock: steps back */
} canser_stats;

/* The device clock, unwrapped over the stream. */
typedef struct {
    int64_t tick_ns;   /* nanoseconds in one tick */
    uint64_t turned;   /* ticks in whole turns of the counter so far */
    uint64_t line;     /* where the clock last ran in line, in unwrapped ticks */
    uint64_t line_at;  /* number of the frame there */
    uint64_t jump_at;  /* number of the last frame whose step was not small */
    uint32_t raw;      /* counter of the last frame as it came */
    uint8_t has_line;  /* 1: `line` is known */
    uint8_t near_line; /* 1: the frame at `jump_at` was near `line` */
} canser_clock;

/* One wire format, a row of the table of protocols. Constant. */
typedef struct {
    const char *name;
    const char *aliases;              /* further accepted spellings, separated by blanks */
    uint8_t frame_min;                /* the shortest frame in bytes */
    uint8_t frame_max;                /* the longest frame as encode writes it, in bytes */
    uint8_t has_clock;                /* 1: frames carry a device timestamp */
    const struct canser_codec *codec; /* private */
} canser_protocol;

/* The state of one stream. Lives in the caller's memory, may be copied, holds
 * no pointer into the caller's buffers. Fields are the library's own. */
typedef struct {
    const canser_protocol *protocol;
    canser_clock clock;
    canser_stats stats;
    uint64_t skip_end; /* stream offset behind the last skipped byte */
    uint8_t carry_len;
    uint8_t carry[CANSER_PACKET_MAX]; /* the start of a packet that is not whole yet */
} canser_decoder;

/* Where a call puts what it finds. The caller sets the arrays and their
 * capacities and owns them; each call sets the two counts. */
typedef struct {
    canser_frame *frames;
    size_t frame_cap;
    int64_t *offsets;         /* stream offset of each frame, frame_cap long; or NULL */
    canser_control *controls; /* or NULL: control packets are counted, not kept */
    size_t control_cap;
    size_t frame_count;
    size_t control_count;
} canser_batch;

/* A stretch of a stream that was decoded before anybody knew where its first packet
 * starts: from a guess, to be joined to all that lies before it. That is how several
 * threads decode one stream. Lives in the caller's memory; fields are the library's
 * own but for the three that say so. */
typedef struct {
    uint64_t begin;      /* for the caller: the stream offset at which it starts, a guess */
    uint64_t end;        /* for the caller: the stream offset behind it */
    size_t frame_count;  /* for the caller: its frames */
    canser_decoder tale; /* what it did, as a stream of its own */
    uint8_t skips_first; /* 1: no packet starts at `begin` */
    size_t settled;      /* joined: so many frames have their times */
    int64_t shift;       /* joined: nanoseconds to add to the times of the others */
    uint32_t raws[CANSER_SETTLE_MAX]; /* device timestamps of the first frames */
} canser_chunk;

/* What canser_encode did. */
typedef struct {
    size_t frame_count; /* frames encoded: the index of the frame that stopped it */
    size_t byte_count;  /* bytes written */
    int refusal;        /* CANSER_REFUSAL_*; NONE unless the status is REFUSED */
} canser_encoded;

/* The protocol at an index of the table, in the order of the names; NULL past
 * the last one. Lives as long as the program. */
const canser_protocol *canser_protocol_at(size_t index);

/* The name of a reject reason: one lower-case word, constant. NULL if there is
 * no such reason. */
const char *canser_reject_name(int reason);

/* What a refusal says and its remedy: one phrase, constant. NULL if there is no
 * such refusal. */
const char *canser_refusal_text(int refusal);

/* Start a stream: all counters zero, nothing held, the clock not started.
 * `tick_ns` is the unit of the device's timestamps in nanoseconds; a protocol
 * without a clock does not use it. Returns CANSER_OK, CANSER_NULL or CANSER_TICK. */
int canser_decoder_init(canser_decoder *self, const canser_protocol *protocol, int64_t tick_ns);

/* Decode the next bytes of the stream into `batch`.
 *
 * Takes all of `data`, unless an array of the batch is full first: then `*used`
 * is less than `data_len`, and the caller calls again with the rest. A packet
 * that is not whole at the end is held and counts as taken. Reads nothing
 * outside data[0..data_len), writes nothing at or past a capacity, and rows
 * past a count are left as they were. With frame_cap 0 nothing is taken.
 *
 * Returns CANSER_OK; on CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP
 * nothing was taken and the decoder is unchanged. `data` may be NULL if
 * `data_len` is 0. `*used` and the counts of the batch are set on every
 * return on which the pointers to them are not NULL. */
int canser_decoder_feed(canser_decoder *self, const uint8_t *data, size_t data_len,
                        canser_batch *batch, size_t *used);

/* Decode the packets and skip the bytes that start in data[0..stop), and hold
 * nothing: what starts there but ends behind it is taken whole, and nothing is taken
 * of the last bytes of `data`, where a packet may not be whole. So the caller may go
 * on at data[*used]. Otherwise, and in what it returns, as canser_decoder_feed; bytes
 * that are still held are taken first, if `data` completes them. */
int canser_decoder_advance(canser_decoder *self, const uint8_t *data, size_t data_len, size_t stop,
                           canser_batch *batch, size_t *used);

/* Decode what starts in data[first..stop) of a stream whose offset at data[0] is
 * `offset`, from a guess where the first packet starts: a scan that begins some way
 * before `first` mostly falls into step on the way. Ends early where an array of the
 * batch is full, and before the last bytes of `data`, as canser_decoder_advance.
 *
 * The frames and offsets are in the batch, but not the times: canser_chunk_deliver()
 * makes them when the chunk is joined. Returns CANSER_OK, or CANSER_NULL, CANSER_TICK,
 * CANSER_MISALIGNED or CANSER_OVERLAP before anything is done; an array without room is
 * CANSER_NULL, too. */
int canser_chunk_decode(canser_chunk *self, const canser_protocol *protocol, int64_t tick_ns,
                        const uint8_t *data, size_t data_len, size_t first, size_t stop,
                        uint64_t offset, canser_batch *batch);

/* Join a chunk to the stream: counters, clock, and the place where it stands, as if
 * `self` had decoded those bytes. `frames` are the chunk's; the first few get their times
 * here. Takes the same time for any number of frames. Returns CANSER_OK; CANSER_NULL;
 * CANSER_APART, and nothing was changed, if the stream does not stand at chunk->begin,
 * holds bytes, is of another protocol or unit, or if the device clock leaps so often that
 * it cannot be told what it does in the chunk. */
int canser_decoder_join(canser_decoder *self, canser_chunk *chunk, canser_frame *frames);

/* Copy frames[first..first + frame_count) of a joined chunk to `out`, with their times.
 * Where they lie there already they get their times; otherwise the two must not overlap.
 * Works on its own arguments alone: meanwhile the stream may go on. Returns CANSER_OK or
 * CANSER_NULL. */
int canser_chunk_deliver(const canser_chunk *self, canser_frame *frames, size_t first,
                         size_t frame_count, canser_frame *out);

/* End the stream: a candidate that lacks bytes is a reject, and what is held is
 * scanned to its end. Call again while carry_len is not 0: an array of the
 * batch was full. Feeding afterwards goes on with the same counters and
 * offsets. Returns as canser_decoder_feed. */
int canser_decoder_flush(canser_decoder *self, canser_batch *batch);

/* Encode frames into `out`, one packet behind the other.
 *
 * Stops before the first frame that does not fit; frame_max bytes for each
 * frame are always enough. Payload past the dlc and the data of a remote frame
 * are not sent. The time goes out in ticks of `tick_ns`, rounded down, modulo
 * 2^32 as a device's counter wraps; a protocol without a clock sends none.
 * Bytes of `out` past byte_count may have been written over.
 *
 * Returns CANSER_OK; CANSER_REFUSED at a frame the format cannot carry, with
 * its index in result->frame_count, why in result->refusal (one of the reasons,
 * if there are several), and all frames before it written; CANSER_NULL,
 * CANSER_TICK, CANSER_MISALIGNED and CANSER_OVERLAP before anything was written. */
int canser_encode(const canser_protocol *protocol, int64_t tick_ns, const canser_frame *frames,
                  size_t frame_count, uint8_t *out, size_t out_cap, canser_encoded *result);

/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
