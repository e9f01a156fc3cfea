/* canser: decode and encode the byte streams of serial CAN adapters.
 *
 * Plain C11 without allocation, I/O or globals that change: the caller owns
 * all memory, but that of tables. Return codes are for mistakes of the caller, counters for errors
 * on the wire. Results are written on every return, also after an error, so
 * that a caller never reads a count of an earlier call.
 *
 * The rule of the scan, for every protocol: at each position either a packet
 * starts (it is taken, and the scan goes on behind it), or more bytes are needed
 * (the bytes are held until the next call), or no packet starts (one skipped byte
 * is counted, and the scan goes on at the next one). The result does not depend
 * on how the stream was cut.
 *
 * Always: bytes_in == bytes_framed + bytes_control + bytes_skipped + bytes held.
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

/* The protocols, in the order of their names, with the bytes of their longest packets. A new
 * protocol is one C file in protocols/, which defines `canser_protocol_NAME`, and one row here. */
#ifndef CANSER_PROTOCOLS
#define CANSER_PROTOCOLS(ROW)                                                                      \
    ROW(canet13, 13)                                                                               \
    ROW(cantalope, 10)                                                                             \
    ROW(seeed, 20)                                                                                 \
    ROW(serial, 19)
#endif

#define CANSER_ROOM(name, packet_max) char name[packet_max];
union canser_longest {
    CANSER_PROTOCOLS(CANSER_ROOM)
};
#undef CANSER_ROOM

/* The longest packet of any protocol, in bytes. */
#define CANSER_PACKET_MAX sizeof(union canser_longest)

/* The bytes that must follow a position for canser_decoder_advance() to decide there: the longest
 * packet, and 4 bytes that a probe reads before it knows that a length is valid. */
#define CANSER_BEHIND (CANSER_PACKET_MAX + 4)

/* Room for a packet. It makes canser_control a multiple of 8 bytes without padding. */
#define CANSER_CONTROL_ROOM (CANSER_PACKET_MAX / 8 * 8 + 7)

/* The formats of text. A new format is one C file in text/, which defines `canser_text_NAME`, and
 * one row here. */
#ifndef CANSER_TEXTS
#define CANSER_TEXTS(ROW) ROW(asc) ROW(candump) ROW(csv) ROW(gvret) ROW(trc)
#endif

/* Python binds the declarations between the two cffi lines. */
/* cffi: begin */

/* ---- For any program: decode, encode, configure an adapter, explain its packets. */

/* Status codes: mistakes of the caller, found before a byte is read or written. */
enum {
    CANSER_OK = 0,
    CANSER_NULL = 1,       /* a pointer that must not be NULL is NULL */
    CANSER_MISALIGNED = 2, /* an array does not lie on its element's alignment */
    CANSER_OVERLAP = 3,    /* an output shares bytes with the input or another output */
    CANSER_REFUSED = 4,    /* encode: the format cannot carry a frame */
    CANSER_TICK = 5,       /* tick_ns is less than 1 */
    CANSER_MISMATCH = 6,   /* join: the chunk does not begin where the stream stands */
    CANSER_UNABLE = 7,     /* configure: the adapter takes no configuration */
    CANSER_RANGE = 8,      /* a value is out of the range of the adapter, or of the call */
    CANSER_NO_CONTROL = 9, /* explain: the bytes are not one whole control packet */
    CANSER_NO_MEMORY = 10  /* tables: there is not enough memory */
};

/* Reasons why no packet starts at a position. One skipped byte is one reject. */
enum {
    CANSER_REJECT_MARKER,  /* the byte is no start mark */
    CANSER_REJECT_TYPE,    /* the format has no such type byte */
    CANSER_REJECT_DLC,     /* the data length code is over 8 */
    CANSER_REJECT_ID,      /* the arbitration id is out of range */
    CANSER_REJECT_END,     /* the end mark is missing */
    CANSER_REJECT_SUM,     /* the checksum is wrong */
    CANSER_REJECT_FIELD,   /* the checksum is right, but a field is out of range */
    CANSER_REJECT_COMMAND, /* a command of unknown length */
    CANSER_REJECT_CUT,     /* the stream ended inside the candidate */
    CANSER_REJECT_COUNT
};

/* Reasons why a format cannot carry a frame. */
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

/* Modes of an adapter on its bus. */
enum {
    CANSER_MODE_NORMAL,
    CANSER_MODE_LOOPBACK, /* receives what it sends itself */
    CANSER_MODE_SILENT,   /* listens only: sends nothing, and acknowledges nothing */
    CANSER_MODE_LOOPBACK_SILENT,
    CANSER_MODE_COUNT
};

/* Kinds of control packets. */
enum {
    CANSER_CONTROL_OTHER, /* its meaning is not documented */
    CANSER_CONTROL_PING,
    CANSER_CONTROL_STATUS,
    CANSER_CONTROL_ERROR,
    CANSER_CONTROL_CONFIGURATION,
    CANSER_CONTROL_COUNT
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

/* A packet that is valid but is no CAN frame. */
typedef struct {
    uint64_t offset;                    /* stream offset of its first byte */
    uint8_t len;                        /* 1..CANSER_PACKET_MAX */
    uint8_t bytes[CANSER_CONTROL_ROOM]; /* the packet as it came; zero past len */
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
    uint64_t ts_uncertain;                 /* steps back of over 2^24 ticks of a clock in line: a
                                            * restart, a silence of more than half a turn, or a
                                            * false time */
} canser_stats;

/* The device clock, unwrapped over the stream. */
typedef struct {
    int64_t tick_ns;   /* nanoseconds in one tick */
    uint64_t turned;   /* ticks of all whole turns of the counter so far */
    uint64_t line;     /* last unwrapped ticks at which the clock ran in line */
    uint64_t line_at;  /* number of that frame in the stream */
    uint64_t jump_at;  /* number of the last frame whose step was not small */
    uint32_t raw;      /* counter of the last frame as it came */
    uint8_t has_line;  /* 1: `line` is known */
    uint8_t near_line; /* 1: the frame at `jump_at` was near `line` */
} canser_clock;

/* A packet for the adapter. */
typedef struct {
    uint8_t len;                      /* 0: there is none */
    uint8_t bytes[CANSER_PACKET_MAX]; /* zero past len */
} canser_packet;

/* One wire format, a row of the table of protocols. Constant. */
typedef struct {
    const char *name;
    const char *aliases;              /* further accepted spellings, separated by blanks */
    uint8_t frame_min;                /* the shortest frame in bytes */
    uint8_t frame_max;                /* the longest frame as encode writes it, in bytes */
    uint8_t has_clock;                /* 1: frames carry a device timestamp */
    uint32_t baudrate;                /* of the serial line, as delivered, in bit/s */
    const uint32_t *bitrates;         /* of the bus, in bit/s, that an adapter can be configured
                                       * to, 0 behind the last; NULL: it takes no configuration */
    canser_packet ping;               /* the adapter sends it back */
    canser_packet status_request;     /* the adapter answers with a status packet */
    const struct canser_codec *codec; /* private */
} canser_protocol;

/* The configuration of an adapter. */
typedef struct {
    uint32_t bitrate;     /* of the bus, in bit/s: one of the row's */
    uint32_t filter_id;   /* the id's bits that frames must have where the mask has a 1 */
    uint32_t filter_mask; /* 0: all frames pass */
    uint8_t mode;         /* CANSER_MODE_* */
    uint8_t ext_only;     /* 1: receives extended frames only; 0: both kinds */
    uint8_t once;         /* 1: sends no frame again that was not acknowledged */
    uint8_t fixed;        /* 1: reports frames in packets of a fixed length */
} canser_config;

/* The meaning of a control packet. Fields that its kind does not have are zero. */
typedef struct {
    int kind;                /* CANSER_CONTROL_* */
    uint8_t receive_errors;  /* STATUS: the adapter's receive error counter */
    uint8_t transmit_errors; /* STATUS: its transmit error counter */
    uint8_t number;          /* ERROR: the adapter's own number of the error */
    canser_config config;    /* CONFIGURATION */
} canser_report;

/* The state of one stream, in the caller's memory. It may be copied, and holds no
 * pointer into the caller's buffers. All fields are private but the counters. */
typedef struct {
    const canser_protocol *protocol;
    canser_clock clock;
    canser_stats stats;
    uint64_t skip_end; /* stream offset behind the last skipped byte */
    uint8_t carry_len;
    uint8_t carry[CANSER_PACKET_MAX]; /* held bytes: the start of a packet that is not whole yet */
} canser_decoder;

/* The results of a call. The caller owns the arrays, and sets them and their
 * capacities. Each call sets the two counts. */
typedef struct {
    canser_frame *frames;
    size_t frame_cap;
    int64_t *offsets;         /* stream offsets of the frames, frame_cap long; or NULL */
    int64_t *ends;            /* stream offsets behind them, as long; or NULL */
    canser_control *controls; /* or NULL: control packets are counted, not kept */
    size_t control_cap;
    size_t frame_count;
    size_t control_count;
} canser_batch;

/* The result of canser_encode(). */
typedef struct {
    size_t frame_count; /* frames encoded: the index of the frame that stopped it */
    size_t byte_count;  /* bytes written */
    int refusal;        /* CANSER_REFUSAL_*; NONE unless the status is REFUSED */
} canser_encoded;

/* The protocol at an index of the table, in the order of the names; NULL past
 * the last one. It is constant. */
const canser_protocol *canser_protocol_at(size_t index);

/* The name of a reject reason: one lower-case word, constant. NULL if there is
 * no such reason. */
const char *canser_reject_name(int reason);

/* The text of a refusal, with the remedy: one phrase, constant. NULL if there is
 * no such refusal. */
const char *canser_refusal_text(int refusal);

/* The name of the frames that are refused for a reason, as counts show it: a plural,
 * constant. NULL if there is no such refusal. */
const char *canser_refusal_name(int refusal);

/* The name of a mode, and of a kind of control packets: lower case, constant. NULL
 * if there is no such number. */
const char *canser_mode_name(int mode);
const char *canser_control_name(int kind);

/* Start a stream: all counters are zero, no byte is held, the clock has not started.
 * `tick_ns` is the unit of the device's timestamps in nanoseconds; a protocol
 * without a clock does not use it. Returns CANSER_OK, CANSER_NULL or CANSER_TICK. */
int canser_decoder_init(canser_decoder *self, const canser_protocol *protocol, int64_t tick_ns);

/* Decode the next bytes of the stream into `batch`.
 *
 * Takes all of `data`, unless an array of the batch becomes full: then `*used`
 * is less than `data_len`, and the caller calls again with the rest. A packet
 * that is not whole at the end is held, and its bytes count as taken. Reads only
 * data[0..data_len), writes only below the capacities, and leaves rows past a
 * count as they were. With frame_cap 0 no byte is taken.
 *
 * Returns CANSER_OK; on CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP
 * nothing was taken and the decoder is unchanged. `data` may be NULL if
 * `data_len` is 0. `*used` and the counts of the batch are set on every
 * return on which the pointers to them are not NULL. */
int canser_decoder_feed(canser_decoder *self, const uint8_t *data, size_t data_len,
                        canser_batch *batch, size_t *used);

/* End the stream: a candidate that lacks bytes is a reject, and the held bytes are
 * scanned to their end. Call again while carry_len is not 0: an array of the
 * batch was full. The stream may be fed afterwards, with the same counters and
 * offsets. Returns as canser_decoder_feed(). */
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

/* Find for each frame the reason for which canser_encode() would refuse it: refusals[i] is
 * CANSER_REFUSAL_*, NONE if the format can carry it. CANSER_REFUSAL_TIME is only given if there
 * is no other reason.
 *
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP before anything was
 * written. `refusals` has room for `frame_count`; it and `frames` may be NULL if that is 0. */
int canser_refuse(const canser_protocol *protocol, const canser_frame *frames, size_t frame_count,
                  uint8_t *refusals);

/* Make the packet that configures an adapter. Any flag but 0 counts as 1.
 *
 * Returns CANSER_OK; CANSER_NULL; CANSER_UNABLE if the row has no bit rates;
 * CANSER_RANGE for a bit rate that is not one of them, an unknown mode, or a filter or
 * mask over 0x1FFFFFFF. `*packet` is set on every return on which it is not NULL; after
 * an error its length is 0. */
int canser_configure(const canser_protocol *protocol, const canser_config *config,
                     canser_packet *packet);

/* Find the meaning of a control packet: of the `len` bytes that a decoder gave for it.
 *
 * The same bytes mean the same in both directions: a request for the status reads as
 * a status without errors. CANSER_CONTROL_OTHER is given for unknown commands, and for
 * configurations with a value that canser_configure() never sends. Filter and mask may
 * have any value of 32 bits.
 *
 * Returns CANSER_OK; CANSER_NULL; CANSER_NO_CONTROL if the bytes are a frame, noise, cut,
 * or more than one packet. `*report` is set on every return on which it is not NULL,
 * to OTHER after an error. */
int canser_explain(const canser_protocol *protocol, const uint8_t *packet, size_t len,
                   canser_report *report);

/* ---- For the binding, and for programs with the same needs: parts of a stream decoded by several
 * threads, host times, recordings, one decoder used by several threads. */

/* The number of frames in which a chunk's clock must settle for the chunk to be joined. */
#define CANSER_SETTLE_MAX 64

/* The longest time of a byte on a line, in nanoseconds: 5 bits a second. */
#define CANSER_BYTE_NS_MAX 2000000000

/* The frames of a piece that are kept for its sample: all but one of them may be false. */
#define CANSER_LEAST_LATE 3

/* A stretch of a stream that was decoded from a guess where its first packet starts. When all bytes
 * before it are decoded, it is joined to the stream. So several threads can decode one stream. It
 * lives in the caller's memory; all fields but the three that say so are private. */
typedef struct {
    uint64_t begin;         /* for the caller: the stream offset at which it starts, a guess */
    uint64_t end;           /* for the caller: the stream offset behind it */
    size_t frame_count;     /* for the caller: its frames */
    canser_decoder decoder; /* the state of the stretch alone, as of a stream */
    uint8_t skips_first;    /* 1: no packet starts at `begin` */
    size_t settled;         /* joined: number of frames that have their times */
    int64_t shift;          /* joined: nanoseconds to add to the times of the others */
    uint32_t raws[CANSER_SETTLE_MAX]; /* device timestamps of the first frames */
} canser_chunk;

/* Decode the packets and skip the bytes that start in data[0..stop), and hold no bytes.
 * A packet that starts there and ends behind it is taken whole. The last CANSER_BEHIND
 * bytes of `data`, where a packet may not be whole, are not taken. So the caller may go
 * on at data[*used]. Bytes that were held before are taken first, if `data` completes
 * them. Everything else, and the returned status, is as in canser_decoder_feed(). */
int canser_decoder_advance(canser_decoder *self, const uint8_t *data, size_t data_len, size_t stop,
                           canser_batch *batch, size_t *used);

/* Decode what starts in data[first..stop) of a stream whose offset at data[0] is
 * `offset`, from a guess where the first packet starts. The guess comes from a scan that
 * begins 4 KiB before `first`: it mostly falls into step with the stream on the way. Ends
 * early if an array of the batch is full, and before the last bytes of `data`, as
 * canser_decoder_advance() does.
 *
 * The batch has the frames and offsets, but no times: canser_chunk_deliver() sets them
 * when the chunk is joined. Returns CANSER_OK, or CANSER_NULL, CANSER_TICK,
 * CANSER_MISALIGNED or CANSER_OVERLAP before anything is done; an array without room is
 * CANSER_NULL, too. */
int canser_chunk_decode(canser_chunk *self, const canser_protocol *protocol, int64_t tick_ns,
                        const uint8_t *data, size_t data_len, size_t first, size_t stop,
                        uint64_t offset, canser_batch *batch);

/* Join a chunk to the stream: its counters, clock and offset become as if `self` had
 * decoded those bytes. `frames` are the chunk's; the first few get their times here. It
 * takes the same time for any number of frames. Returns CANSER_OK; CANSER_NULL;
 * CANSER_MISMATCH, and nothing was changed, if the stream does not stand at chunk->begin,
 * holds bytes, has another protocol or unit, or if the device clock does not settle within
 * CANSER_SETTLE_MAX frames. */
int canser_decoder_join(canser_decoder *self, canser_chunk *chunk, canser_frame *frames);

/* Copy frames[first..first + frame_count) of a joined chunk to `out`, with their times.
 * If `out` is their own place, they get their times there; otherwise the two must not
 * overlap. Uses its arguments only: meanwhile the stream may go on. Returns CANSER_OK or
 * CANSER_NULL. */
int canser_chunk_deliver(const canser_chunk *self, canser_frame *frames, size_t first,
                         size_t frame_count, canser_frame *out);

/* A piece: the bytes of one read of a port, behind those of the read before. */
typedef struct {
    int64_t end; /* stream offset behind its bytes */
    int64_t ns;  /* the host's time when they had come */
} canser_piece;

/* A sample: the least late frame of a piece, its device time and its arrival. */
typedef struct {
    int64_t device;
    int64_t arrival;
    int64_t counted; /* how far it was counted back from the last frame of the piece */
} canser_sample;

/* The frames of a piece with the lowest differences arrival - device time, the lowest first; of
 * equal ones the first ones. Private. */
typedef struct {
    size_t count;
    canser_sample frames[CANSER_LEAST_LATE];
} canser_least_late;

/* The turn of its counter that a device's clock is in. Private. */
typedef struct {
    int64_t shift;      /* nanoseconds to add to a decoder's time */
    int64_t delay;      /* arrival - device time of the last frame near those before it */
    int64_t last_delay; /* the same for the last frame that was not near them */
    uint8_t run;        /* number of such frames in a row that were near each other */
    uint8_t started;    /* 1: `delay` and `shift` are set */
} canser_turns;

/* The line that maps a device's clock: host's time = host + run + run * drift, where run =
 * device time - device; rounded towards `host + run`, modulo 2^64. */
typedef struct {
    int64_t device;
    int64_t host;
    double drift; /* between -1 and 1 */
} canser_line;

/* Limits within which a time of the line is believed. */
typedef struct {
    int64_t reached; /* a device time that the clock has reached */
    int64_t early;   /* 0 or more: how far a device time may lie before `reached`, and a
                      * host time behind its arrival */
    int64_t late;    /* 0 or more: how far a host time may lie before its arrival */
} canser_trust;

/* Reasons why canser_timing_assign() returned. */
enum {
    CANSER_TIMING_DONE = 0,    /* all frames have their times */
    CANSER_TIMING_BUCKET = 1,  /* there are enough samples to learn from */
    CANSER_TIMING_FULL = 2,    /* there is no room for another sample */
    CANSER_TIMING_SILENCE = 3, /* the next frame comes after a silence */
};

/* The state of one stream's times. The caller zeroes it, and sets the fields that are not private.
 * Those marked "any time" may be set between any two calls. */
typedef struct {
    int64_t tick_ns;        /* unit of the device's times, at most INT32_MAX; 0: it sends none */
    uint8_t keeps_device;   /* 1: frames keep the device's time, with the turn set */
    int64_t silence_ns;     /* a longer time between two arrivals stops a call */
    int64_t bucket_ns;      /* samples are enough if the first and the last are this far apart, */
    size_t bucket_least;    /* and there are this many; */
    size_t bucket_most;     /* any time: or if there are this many */
    double byte_ns;         /* any time: time of a byte on the line, 0 to CANSER_BYTE_NS_MAX */
    canser_line line;       /* any time: the line that maps the device's clock */
    uint8_t has_line;       /* any time: 1 if `line` is known */
    canser_trust trust;     /* any time */
    canser_sample *samples; /* any time: room for samples */
    size_t sample_cap;      /* any time: its length; if that is 0, `samples` may be NULL */
    size_t sample_count;    /* any time: samples in it; calls add to them */
    int stopped;            /* CANSER_TIMING_*: why the last call returned */
    /* Private. */
    canser_turns turns;
    canser_least_late least_late; /* those of the last frame's piece */
    int64_t piece_end;            /* `end` of that piece */
    int64_t arrived;              /* arrival of the last frame */
    int64_t latest;               /* no host time lies before this one */
} canser_timing;

/* Set the times of frames[*done..count), the next ones of a stream, in place. `*done` is raised as
 * frames get them.
 *
 * If the device sends times, at[i] is the stream offset of a frame's first byte; else it is the
 * offset behind its last byte. The arrival is that of this first or last byte. A byte came with
 * the first piece that ends behind it: earlier than pieces[].ns by the time that the rest of the
 * piece takes on the line, rounded down, but not before the piece before. So pieces[0] only tells
 * when the next piece began, unless one of these bytes lies in it. Bytes behind the last piece
 * have its time. Without times of a device frames get their arrivals, and frames[i].ts may have
 * any value before.
 *
 * With times of a device frames[i].ts is what a decoder with the same `tick_ns` gave. A counter of
 * 32 bits does not tell its turn. The arrival tells it, as long as it is late by less than half a
 * turn: after a silence of any length, and after any false times. The first frame keeps the value
 * of its counter. A frame then gets
 *
 * - with keeps_device, this time of the device;
 * - its arrival, if no line is known or the time of the line is not believed;
 * - else the time of the line, but none behind its arrival, none before another time of the line,
 *   and none before the last arrival without a line.
 *
 * Each piece with a frame gives a sample, from which the caller can estimate the device's clock:
 * its frame with the lowest difference arrival - device time. A false frame has any device time,
 * so one of the two lowest that is over a minute lower than the next one does not count. A sample
 * is given when a frame of a later piece is there. A call stops before that frame if the samples
 * are enough or their room is full. It also stops before the first frame after a silence. The
 * caller sets what it has learned, and calls again with the rest.
 *
 * Pieces and offsets must be in ascending order, a piece must have less than 2^32 bytes, and a
 * device must have run for less than 2^63 nanoseconds. Otherwise the times are wrong. The times do
 * not depend on how frames are cut into calls. Returns CANSER_OK; CANSER_NULL (also for no pieces),
 * CANSER_MISALIGNED, CANSER_TICK or CANSER_RANGE before anything is written. */
int canser_timing_assign(canser_timing *self, const canser_piece *pieces, size_t piece_count,
                         const int64_t *at, canser_frame *frames, size_t count, size_t *done);

/* The blocks of a recording that canser_recording_gather() takes. The caller sets the first three
 * fields. A call leaves in next_id the id for the next call. */
typedef struct {
    uint64_t next_id;         /* id of the next block, if no block is missing */
    uint32_t interface;       /* the number of the interface in the file */
    uint8_t has_ids;          /* 1: blocks have ids; 0: drop counts instead, in old files */
    uint32_t crc32s[16][256]; /* private: the CRC32 of a byte with 0 to 15 zeros behind it */
} canser_recording;

/* The result of canser_recording_gather(). */
typedef struct {
    size_t used;        /* bytes of the file that were taken: whole blocks */
    size_t byte_count;  /* bytes of the line */
    size_t piece_count; /* blocks */
} canser_gathered;

/* Set up the tables for all calls. Returns CANSER_OK or CANSER_NULL. */
int canser_recording_init(canser_recording *self);

/* Gather the bytes of the line from the blocks of a recording, one behind the other.
 *
 * Takes usual blocks from data[0] on. A usual block is a little-endian enhanced packet block of the
 * interface, with at least one byte, as RecordingWriter writes it. Its CRC32 is right, its id is
 * the next one (without ids its drop count is 0), it has no comment, and its time is less than
 * 2^63. Stops before any other block, before a block that is not whole in data or does not fit into
 * `out`, and when `pieces` is full. A block before which it stops may be a good one: the caller
 * has to look at it.
 *
 * pieces[i] has the end of block i's bytes in `out`, and its time. Bytes of `out` past
 * byte_count may have been written over. Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and
 * CANSER_OVERLAP before anything was written. An array may be NULL if its length is 0. `*result`
 * is set on every return on which it is not NULL. */
int canser_recording_gather(canser_recording *self, const uint8_t *data, size_t data_len,
                            uint8_t *out, size_t out_cap, canser_piece *pieces, size_t piece_cap,
                            canser_gathered *result);

/* A decoder that several threads may use, for a binding to a language in which each call is
 * expensive. While one thread uses it, the calls of other threads return at once, and must be
 * repeated. */
typedef struct {
    canser_decoder decoder; /* may be read at any time, and changed between take and release */
    uint8_t keeps_controls; /* set by the caller: 1: canser_stream_feed() takes no control packet */
    uint32_t taken;         /* private: who uses it */
} canser_stream;

/* The most bytes of one small call, as other threads may wait until it ends. */
#define CANSER_SMALL_MAX 1048576

/* Take the stream: until canser_stream_release() only the caller may use its decoder. Returns 1, or
 * 0 if another caller has it. */
int canser_stream_take(canser_stream *self);

/* Release the stream, if canser_stream_take() took it. */
void canser_stream_release(canser_stream *self);

/* Arrays to decode into, as in a canser_batch; a small call changes nothing here. */
typedef struct {
    canser_frame *frames;
    size_t frame_cap;
    int64_t *offsets;
    int64_t *ends;
} canser_target;

/* Decode the next bytes of a stream, as canser_decoder_feed().
 *
 * It does all or nothing. Returns the number of frames. If `frames` is full, 2^32 times the number
 * of bytes that were not taken is added. Returns -1, with no change but to rows of the arrays, if
 * the stream is taken, an argument is wrong, there are over CANSER_SMALL_MAX bytes, or a control
 * packet among them must be kept. canser_decoder_feed() then does the work, or names the mistake.
 */
int64_t canser_stream_feed(canser_stream *self, const uint8_t *data, size_t data_len,
                           const canser_target *target);

/* Decode a whole stream. Returns the number of frames, plus 2^32 times the number of skipped bytes.
 * Returns -1 if an argument is wrong, there are over CANSER_SMALL_MAX bytes, or `frames` is full.
 */
int64_t canser_decode_small(const canser_protocol *protocol, int64_t tick_ns, const uint8_t *data,
                            size_t data_len, canser_frame *frames, size_t frame_cap);

/* ---- For log files of other programs: lines of text as frames, and frames as lines. */

/* The channel of a frame for which none is told. */
#define CANSER_NO_CHANNEL 255

/* The names of channels that a file may have, and the longest one in bytes. */
#define CANSER_NAMES_MAX    16
#define CANSER_NAME_LEN_MAX 15

/* The direction of a frame, as the program saw it that wrote the file. */
enum { CANSER_RECEIVED = 0, CANSER_SENT = 1 };

/* A format of text. Constant. */
typedef struct {
    const char *name;
    const struct canser_text_codec *codec; /* private */
} canser_text_format;

/* The name of a channel, such as "can0". The caller sets the fields by canser_text_add_name(). */
typedef struct {
    uint64_t text[2]; /* the name and a blank, zero past it */
    uint64_t mask[2]; /* all ones for each of these bytes */
    uint8_t len;      /* of the name */
    uint8_t channel;
} canser_channel_name;

/* The state of one file that is read or written. The caller zeroes it, and sets `format`, and the
 * fields that are of use for the format. */
typedef struct {
    const canser_text_format *format;
    char columns[16];    /* trc, gvret: letters of the columns, zero behind them */
    int64_t start_ns;    /* written, asc and trc: the time from which times count */
    int64_t last_ns;     /* read, asc: the time of the last line, with is_relative */
    uint8_t is_relative; /* read, asc: 1: times count from the line before */
    uint8_t is_decimal;  /* read, asc: 1: ids and bytes are decimal numbers */
    uint8_t is_dated;    /* written, candump: 1: times are dates, in UTC */
    uint8_t name_count;  /* of `names`, which canser_text_add_name() adds */
    canser_channel_name names[CANSER_NAMES_MAX]; /* candump: names of channels */
    uint64_t steps_back;    /* read: times that lie before that of the frame before */
    int64_t before_ns;      /* read: the time of the frame before */
    uint64_t fd_count;      /* read: lines of CAN FD, left out */
    uint64_t cut_times;     /* written: times that lost places which the format does not have */
    uint64_t unknown_times; /* written: frames without a time */
    uint64_t error_frames;  /* written, asc and trc: error frames, whose id and data are lost */
    /* Private. */
    uint64_t number;      /* written, trc: of the last line */
    uint64_t number_text; /* written, trc: its first eight characters */
    uint64_t second;      /* of the last line */
    uint8_t second_text[24];
    uint8_t second_len;
    uint8_t has_second;
    uint8_t last_name;    /* read: index of the name in the last line */
    uint32_t seconds_low; /* read: the last seconds, as text and time; asc: length of the text */
    uint64_t seconds_high;
    int64_t seconds_ns;
    uint8_t has_name; /* written: whether there is `name`, that of the last line */
    canser_channel_name name;
} canser_text;

/* Room for the frames of lines, and the result of a call. The caller owns the arrays, and sets the
 * first four fields. Each call sets the others. */
typedef struct {
    canser_frame *frames;
    uint8_t *channels;   /* as long; CANSER_NO_CHANNEL if the line tells none */
    uint8_t *directions; /* as long; CANSER_RECEIVED if the line tells none */
    size_t frame_cap;
    size_t frame_count;
    size_t line_count; /* lines taken: those of the frames, and those that are only counted */
    size_t used;       /* bytes taken: whole lines */
    int is_unusual;    /* 1: the next line is whole, and is for the caller to read */
} canser_rows;

/* The format at an index of the table; NULL past the last one. */
const canser_text_format *canser_text_at(size_t index);

/* Add the name of a channel: `len` bytes without blanks. Returns CANSER_OK; CANSER_NULL;
 * CANSER_RANGE for an empty name, one over CANSER_NAME_LEN_MAX bytes, and over CANSER_NAMES_MAX
 * names, with no change. */
int canser_text_add_name(canser_text *self, const char *name, size_t len, uint8_t channel);

/* Read lines of text as frames.
 *
 * Takes whole lines from data[0] on. It stops before an unusual line, before a line that is not
 * whole, and when the rows are full. A line that it takes is a frame of classic CAN in the usual
 * spelling, or it is counted in the state. The caller reads unusual lines by itself: comments,
 * other spellings, mistakes. Reads only data[0..data_len), and writes rows below frame_cap only.
 *
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP before anything was read.
 * The results in `*rows` are set on every return on which it is not NULL. */
int canser_text_read(canser_text *self, const uint8_t *data, size_t data_len, canser_rows *rows);

/* Write frames as lines of text, one behind the other. Stops when `out` may have no room for the
 * next line; 160 bytes for each frame are always enough.
 *
 * `channels` and `directions` are as long as `frames`, or NULL. Returns CANSER_OK; CANSER_REFUSED
 * at a frame that is none of classic CAN, with its index in result->frame_count and the reason in
 * result->refusal, and all frames before it written; CANSER_NULL, CANSER_MISALIGNED and
 * CANSER_OVERLAP before anything was written. Bytes of `out` past byte_count may have been written
 * over. */
int canser_text_write(canser_text *self, const canser_frame *frames, const uint8_t *channels,
                      const uint8_t *directions, size_t frame_count, uint8_t *out, size_t out_cap,
                      canser_encoded *result);

/* ---- For log files of Vector: objects of BLF as frames, and frames as objects. */

/* The largest object that is read, in bytes; the room that is always enough to write one. */
#define CANSER_BLF_OBJECT_MAX  16777216
#define CANSER_BLF_WRITTEN_MAX 64

/* Reasons why canser_blf_read() returned. */
enum {
    CANSER_BLF_MORE = 0,      /* the next object is not whole, or there is none */
    CANSER_BLF_FULL = 1,      /* the rows are full */
    CANSER_BLF_CONTAINER = 2, /* the next object is a container */
    CANSER_BLF_SIGNATURE = 3, /* damaged: no object begins within 8 bytes behind the last one */
    CANSER_BLF_SIZE = 4       /* damaged: the object's size is over CANSER_BLF_OBJECT_MAX, or too
                               * small for its type */
};

/* The state of one file that is read or written. The caller zeroes it, and sets `start_ns`. */
typedef struct {
    int64_t start_ns;       /* written: the time from which times count, not negative */
    int stopped;            /* read: CANSER_BLF_*: why the last call returned */
    uint32_t size;          /* read: of the object before which it stopped, 0 if not known */
    uint64_t fd_count;      /* read: objects of CAN FD, left out */
    uint64_t odd_frames;    /* read: those whose id or dlc no frame of classic CAN has, left out */
    uint64_t odd_errors;    /* read: error frames with such an id or dlc, cut to the limit */
    uint64_t lost_channels; /* read: frames of channels that have no code */
    uint64_t lost_times;    /* read: frames whose time does not fit, without a time */
    uint64_t unknown_times; /* written: frames without a time, at 0 */
    uint64_t early_times;   /* written: times before the start, at 0 */
    uint64_t remote_errors; /* written: error frames that are remote frames, too, which is lost */
    int64_t last_ns;        /* written: the latest time */
} canser_blf;

/* Read objects of a BLF file as frames.
 *
 * `data` is a part of the file behind its header, or of the inflated bytes of its containers, which
 * are one stream. It begins at an object, or with the padding before one. A call takes whole
 * objects, with the padding before each: frames of classic CAN go into the rows, and others are
 * left out. It stops as self->stopped tells. At a container and at an object of a wrong size,
 * `rows->used` is the place of that object. `rows->line_count` is the number of objects taken, and
 * `rows->is_unusual` is 1 if the next one is damaged. Reads only data[0..data_len), and writes rows
 * below frame_cap only.
 *
 * Channels are numbers from 1 in the file, and codes from 0 in the rows. Times count from the start
 * of the file, in nanoseconds. An old error frame (type 2) tells no id and no data.
 *
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP before anything was read.
 * The results in `*rows` are set on every return on which it is not NULL. */
int canser_blf_read(canser_blf *self, const uint8_t *data, size_t data_len, canser_rows *rows);

/* Write frames as objects, one behind the other: type 86 for data and remote frames, 73 for error
 * frames. Stops when `out` may have no room for the next one: CANSER_BLF_WRITTEN_MAX bytes for each
 * frame are always enough. A frame without a channel gets the first one.
 *
 * `channels` and `directions` are as long as `frames`, or NULL. Returns as canser_text_write(). */
int canser_blf_write(canser_blf *self, const canser_frame *frames, const uint8_t *channels,
                     const uint8_t *directions, size_t frame_count, uint8_t *out, size_t out_cap,
                     canser_encoded *result);

/* ---- For captures of CAN frames, as Wireshark and tcpdump write them: pcap and pcapng. */

/* An interface of a capture: the kind of its packets, and the unit of their times. The caller sets
 * it by canser_interface_init(). All fields are private. */
typedef struct {
    uint64_t scale;     /* nanoseconds in one tick, with up to 9 decimal places */
    uint64_t most;      /* the most ticks that fit, with a decimal unit */
    uint64_t divide;    /* ticks in one nanosecond, with more places; 0: more than fit */
    int64_t offset_ns;  /* added to all times */
    uint32_t link_type; /* as the file formats number it */
    uint8_t shift;      /* binary places of a time in seconds */
    uint8_t is_binary;
    uint8_t channel;
} canser_interface;

/* Link types of CAN: frames of SocketCAN, and the same behind a header of 16 bytes. */
enum { CANSER_LINK_CAN = 227, CANSER_LINK_COOKED = 113 };

/* The state of one capture that is read or written. The caller zeroes it, and sets the fields that
 * are of use. */
typedef struct {
    const canser_interface *interfaces; /* read: those of the section; pcap has one */
    size_t interface_count;
    uint8_t is_blocks;      /* 1: blocks of pcapng; 0: records of pcap */
    uint8_t is_big;         /* read: 1: its numbers are big-endian */
    uint8_t numbers[256];   /* written, pcapng: the number of the interface of each channel */
    uint64_t fd_count;      /* read: packets of CAN FD, left out */
    uint64_t xl_count;      /* read: packets of CAN XL, left out */
    uint64_t other_count;   /* read: packets of other networks, left out */
    uint64_t bad_count;     /* read: packets of CAN that are no frame, left out */
    uint64_t cut_count;     /* read: packets without all bytes of their frame, left out */
    uint64_t dropped_count; /* read: packets that were lost, as blocks tell */
    uint64_t comment_count; /* read: comments on packets */
    uint64_t unknown_times; /* written: frames without a time */
    uint64_t outside_times; /* written: frames with a time that the format cannot hold */
} canser_capture;

/* Set up an interface. `resolution` is the unit of its times, as pcapng has it: 10^-n seconds, or
 * 2^-n seconds with 0x80 + n. Returns CANSER_OK or CANSER_NULL. */
int canser_interface_init(canser_interface *self, uint32_t link_type, uint8_t channel,
                          uint8_t resolution, int64_t offset_ns);

/* Read packets of a capture as frames: records of pcap, or enhanced packet blocks of pcapng.
 *
 * Takes whole packets from data[0] on. It stops before any other block, before a packet that is not
 * whole, and when the rows are full. A packet that it takes is a frame of classic CAN, or it is
 * counted in the state. The caller looks at unusual blocks by itself: those of other types, of
 * interfaces that are not described, with lengths that do not fit, with times over 64 bits of
 * nanoseconds; and records of pcap without bytes. Times are rounded down to the nanosecond.
 * In the rows, a line is a packet. Reads only data[0..data_len), and writes rows below frame_cap
 * only.
 *
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP before anything was read;
 * CANSER_RANGE for pcap without an interface. The results in `*rows` are set on every return on
 * which it is not NULL. */
int canser_capture_read(canser_capture *self, const uint8_t *data, size_t data_len,
                        canser_rows *rows);

/* Write frames as packets of SocketCAN, one behind the other: little-endian records of pcap, or
 * enhanced packet blocks of pcapng, with times in nanoseconds. Stops when `out` has no room for the
 * next one; CANSER_CAPTURED_MAX bytes for each frame are always enough.
 *
 * Everything else, and the returned status, is as in canser_text_write(). */
int canser_capture_write(canser_capture *self, const canser_frame *frames, const uint8_t *channels,
                         const uint8_t *directions, size_t frame_count, uint8_t *out,
                         size_t out_cap, canser_encoded *result);

/* The longest packet as it is written, the longest block of pcapng and the longest packet in a
 * record of pcap that are read, in bytes. Wireshark has the same limits for reading. */
#define CANSER_CAPTURED_MAX 60
#define CANSER_BLOCK_MAX    16777216
#define CANSER_RECORD_MAX   262144

/* ---- For the load of a bus: the lengths of frames in bits. */

/* The longest frame on the bus, in bits. */
#define CANSER_FRAME_BITS_MAX 160

/* Tables for canser_frame_bits(), in the caller's memory, filled once by canser_bits_init() and
 * only read from then on. Private. */
typedef struct {
    uint16_t crc[13][256];    /* the CRC of a byte with so many zero bytes behind it */
    uint16_t stuff[10 * 256]; /* by the state in front of a byte and the byte: the state behind
                               * it, times 256, plus the stuff bits in it */
    uint16_t start[2][32];    /* the same for the first bits of a frame: see bits.c */
} canser_bits;

/* Fill the tables. Returns CANSER_OK or CANSER_NULL. */
int canser_bits_init(canser_bits *self);

/* Set bits[i] to the length of frames[i] on a bus of classic CAN, in bits: from its start to the
 * third bit of the pause behind it, with the stuff bits, which depend on its CRC. At least 47, at
 * most CANSER_FRAME_BITS_MAX. A dlc of over 8 counts as 8 bytes of data, and a remote frame has
 * none. An error frame has no length that is known: 0.
 *
 * Returns CANSER_OK; CANSER_NULL or CANSER_MISALIGNED before anything was written. `frames` and
 * `bits` may be NULL if `frame_count` is 0. */
int canser_frame_bits(const canser_bits *self, const canser_frame *frames, size_t frame_count,
                      uint8_t *bits);

/* ---- For statistics: the runs of a bus's times, and frames by their ids. */

/* The bins of long steps, 8 for each power of two; the last one has all steps from 2^61 ns on. */
#define CANSER_RUN_BINS 288

/* The first steps of a bus, of which the unit of its times is found. */
#define CANSER_UNIT_STEPS 1024

/* The steps of an id: the first CANSER_EARLY_STEPS are in its row, because noise makes many ids of
 * a few frames; then a list of up to CANSER_STEP_LIST, then a histogram in as much memory. Bin i
 * has the number of its steps at 2 * i, and behind it their sum. Its width is at most 1/128 of its
 * steps, for steps from 1 us to 4.8 hours. */
#define CANSER_EARLY_STEPS 8
#define CANSER_STEP_BINS   4352
#define CANSER_STEP_LIST   8704 /* 2 * CANSER_STEP_BINS */

/* The number of a frame without a row, and its step, if a frame has none. */
#define CANSER_NO_ROW  0xFFFFFFFF
#define CANSER_NO_STEP -1

/* Runs of times, in the order in which the frames came. A run ends at a jump of the clock: a step
 * back by more than a second. It ends at a hole, too: a silence of more than a second, and of more
 * than 20 times the step that 99.9 % of the steps before it do not exceed (before there are 10
 * steps: an hour). If one of the next four times continues the run before, the run goes on with it,
 * and those between were false. So a run is a stretch of time in which frames were recorded, and
 * the result is the same wherever the frames are cut. All fields are private but the unit. It
 * starts with all bytes zero. */
typedef struct {
    int64_t last;         /* the last time of the run */
    int64_t last_before;  /* that of the run before the last jump */
    uint64_t jump;        /* the last jump if it went forward, in nanoseconds; or 0 */
    uint64_t unit;        /* the greatest common divisor of the first CANSER_UNIT_STEPS steps, in
                           * nanoseconds; 0 if all were 0 */
    uint32_t unit_steps;  /* steps that it was found of */
    uint32_t run;         /* the number of the run, from 1 on; 0: there was no time */
    uint32_t run_before;  /* that of the run before the last jump */
    uint32_t last_number; /* the last number that was given */
    uint32_t since;       /* times since the last jump, if they may still be false; or 0 */
    uint64_t steps;       /* steps between neighbours of a run */
    uint64_t long_steps;  /* of over 50 ms */
    uint64_t bins[CANSER_RUN_BINS]; /* these by their length */
} canser_runs;

/* Statistics of the frames of one id, kind and channel. Steps are times in nanoseconds from one
 * frame of the row to the next one. Only steps within a run count, and none back. */
typedef struct {
    uint32_t id;
    uint8_t ext;
    uint8_t rtr;     /* 0 if remote frames have no row of their own */
    uint8_t channel; /* 255: not told */
    uint8_t err;
    uint8_t data[8];    /* of the last frame */
    uint8_t head[8];    /* the first 8 bytes of the last frame, as none that is remote */
    int64_t first;      /* the first known time, or CANSER_NO_TIME */
    int64_t last;       /* the last known time, or CANSER_NO_TIME */
    uint8_t moving[8];  /* bits of the data that were not the same in all frames */
    uint64_t changes;   /* frames whose data or dlc differ from those of the frame before */
    uint64_t remote;    /* remote frames */
    uint64_t steps;     /* number of steps, which is that of frames with a step */
    uint64_t breaks;    /* frames without a step */
    uint64_t least;     /* the shortest step, if there are steps */
    uint64_t spread;    /* what the longest step is longer by */
    int64_t longest_at; /* the time at which the first of the longest steps began */
    uint64_t sum;       /* of the steps until `base`; those behind it sum up to last - base */
    int64_t base;
    uint32_t run;    /* private: the run that `last` is in */
    uint32_t list;   /* private: the list of the steps, and one more; 0: there is none yet */
    uint32_t listed; /* steps in the row or the list; over CANSER_STEP_LIST: it is a histogram */
    uint32_t dlcs;   /* bit i: there are frames with the dlc i */
    uint64_t early[CANSER_EARLY_STEPS]; /* private: the first steps, if steps are kept */
} canser_id;

/* Frames by their ids, in the caller's memory. The caller sets the arrays and their sizes, may
 * replace them by longer copies between two calls, and changes nothing else. It starts with all
 * other bytes zero. */
typedef struct {
    canser_id *rows; /* in the order in which they appeared */
    size_t row_cap;
    size_t row_most; /* frames that would need more rows have none */
    size_t row_count;
    uint64_t spread;  /* any odd number, or 0: a row's slot is in the upper half of the product of
                       * its key. One that is not known before keeps ids from being made that
                       * meet in few slots */
    uint32_t *slots;  /* private: numbers of rows by their keys; zero at first */
    size_t slot_cap;  /* a power of two, at least twice row_cap */
    uint64_t **lists; /* pointers to CANSER_STEP_LIST elements each, zero at first; may change
                       * places. NULL: keep no steps */
    size_t list_cap;  /* one of them stays free */
    size_t list_count;
    uint64_t others;         /* frames without a row */
    uint8_t is_remote_apart; /* 1: remote frames have rows of their own */
    canser_runs runs;
} canser_ids;

/* Find the runs of times: run_of[i] is the number of the run that frames[i] is in, 0 if its time
 * is not known or false. Times at the end of a call that a later call finds to be false keep their
 * numbers. Returns CANSER_OK; CANSER_NULL or CANSER_MISALIGNED before anything was done. `frames`
 * and `run_of` may be NULL if `frame_count` is 0. */
int canser_runs_add(canser_runs *self, const canser_frame *frames, size_t frame_count,
                    uint32_t *run_of);

/* Add frames, in the order in which they came, with their channels (NULL: not told). `row_of` and
 * `steps`, if they are not NULL, get the row of each frame, or CANSER_NO_ROW, and the step from
 * the frame before it in the row, or CANSER_NO_STEP.
 *
 * Stops before a frame that needs a row or a list for which there is no room: then `*used` is less
 * than `frame_count`, and the caller goes on with larger arrays. Returns CANSER_OK; CANSER_NULL,
 * CANSER_MISALIGNED, or CANSER_RANGE for an unfit slot_cap before anything was done. */
int canser_ids_add(canser_ids *self, const canser_frame *frames, size_t frame_count,
                   const uint8_t *channels, uint32_t *row_of, int64_t *steps, size_t *used);

/* Find the row of each frame, and count the frames of each row in `breaks`; nothing else of the
 * rows is set but what tells the id. Stops and returns as canser_ids_add(), but that `row_most` has
 * no effect. */
int canser_ids_group(canser_ids *self, const canser_frame *frames, size_t frame_count,
                     const uint8_t *channels, uint32_t *row_of, size_t *used);

/* Fill the slots, which are all zero, from the rows: after the caller has made them more.
 * Returns CANSER_OK, CANSER_NULL or CANSER_RANGE. */
int canser_ids_fill_slots(canser_ids *self);

/* Sort frames by their rows, stably: out[next[r]..ends[r]) gets the numbers of row r's frames; or,
 * if `steps` is not NULL, their steps, of those that have one. Frames without a row are left out.
 * next[r] becomes the place behind the last one. Returns CANSER_OK; CANSER_NULL; CANSER_RANGE if a
 * place is not in `out`, or a row has more frames than places: then `out` holds a part. */
int canser_order_rows(const uint32_t *row_of, const int64_t *steps, size_t frame_count,
                      int64_t *next, const int64_t *ends, size_t row_count, int64_t *out,
                      size_t out_cap);

/* ---- For frames whose payload changes. */

/* The key of no frame: the place is free. */
#define CANSER_NO_KEY 0xffffffffffffffff

/* The last frame of an id, kind and channel. */
typedef struct {
    uint64_t head; /* its first 8 bytes, with the dlc */
    uint64_t data;
    uint64_t key;    /* what tells the id, kind and channel; or CANSER_NO_KEY */
    uint64_t unused; /* so that each lies in one line of the cache */
} canser_last;

/* The last frames, in an open hash. It starts with all bytes zero but `spread`. */
typedef struct {
    canser_last *lasts;
    size_t cap;
    size_t count;
    uint64_t spread; /* any odd number; one that is not known before keeps ids from being made that
                      * meet in few places */
} canser_changes;

/* Copy the frames to `out` whose data or dlc differ from those of the frame before of the same id,
 * kind and channel, and the first one of each. `channels` may be NULL: all are one.
 *
 * Stops when `out` is full, or before a frame of a new id if half of the places are used: then
 * `*used` is less than `frame_count`, and the caller goes on after canser_changes_move(). Returns
 * CANSER_OK; CANSER_NULL, CANSER_MISALIGNED, or CANSER_RANGE for an unfit cap, before anything was
 * done. */
int canser_changes_add(canser_changes *self, const canser_frame *frames, size_t frame_count,
                       const uint8_t *channels, canser_frame *out, size_t out_cap, size_t *used,
                       size_t *out_count);

/* Move the last frames to other memory with `cap` places, a power of two, whose values do not
 * matter. Returns CANSER_OK, CANSER_NULL, or CANSER_RANGE if more than half would be used. */
int canser_changes_move(canser_changes *self, canser_last *lasts, size_t cap);

/* ---- For signals: the numbers that a database finds in the data of frames. */

/* Samples that are kept for a group before its signals are decoded. */
#define CANSER_SIGNAL_BLOCK 1024

/* How deep multiplexers may lie behind multiplexers: C goes down by calls. */
#define CANSER_MUX_DEPTH 32

/* No message, no table; no page, and pages that a route has no room for. */
#define CANSER_NO_MESSAGE 0xffffffff
#define CANSER_NO_TABLE   0xffffffff
#define CANSER_NO_ROUTE   0xffff
#define CANSER_FAR_ROUTE  0xfffe

/* No frame of a message begins so: it would be an error. */
#define CANSER_NO_HEAD 0xffffffffffffffff

/* Where a number lies in the 8 bytes of data, which are one number of 64 bits. */
typedef struct {
    uint8_t is_big;    /* 1: the first byte is the highest one; 0: it is the lowest one */
    uint8_t shift;     /* bits below the number */
    uint8_t bit_count; /* 1 to 64 */
    uint8_t is_signed; /* 1: two's complement */
} canser_field;

/* What the bits of a signal are, and the type of its column. Whole numbers become
 * raw * scale + offset, modulo 2^64, which is a whole number again. All others become
 * raw * factor + addend, in float64, with two roundings; or the raw number itself. */
enum {
    CANSER_SIGNAL_WHOLE,   /* bits: a whole number; column: int64 or uint64 */
    CANSER_SIGNAL_SCALED,  /* bits: a whole number; column: float64 */
    CANSER_SIGNAL_FLOAT16, /* bits: IEEE 754, of 16, 32 or 64 bits; column: float64 */
    CANSER_SIGNAL_FLOAT32,
    CANSER_SIGNAL_FLOAT64
};

typedef struct {
    double factor;
    double addend;
    int64_t scale;
    int64_t offset;
    void *values; /* the column: as many elements of 8 bytes as its group has room for */
    canser_field field;
    uint8_t kind;
    uint8_t is_raw; /* 1: the raw number itself */
} canser_signal;

/* Private: where the next sample of a group goes in its block, and the end of its room there. */
typedef struct {
    uint64_t *next;
    const uint64_t *end;
} canser_cursor;

/* Signals that are in the same frames. */
typedef struct {
    int64_t *ts; /* the column of times */
    size_t cap;
    size_t count;
    uint64_t *block; /* private, of 2 * CANSER_SIGNAL_BLOCK elements: data as it lies in frames,
                      * then times */
    canser_cursor cursor;
    uint32_t first_signal;
    uint32_t signal_count;
    uint32_t least_dlc; /* shorter frames do not have these signals */
} canser_group;

/* What is there together: what a message always has, or what a value of a multiplexer selects. */
typedef struct {
    uint32_t first_group;
    uint32_t group_count; /* groups by their least_dlc, the smallest first */
    uint32_t first_mux;
    uint32_t mux_count;
    uint32_t full_dlc; /* shorter frames do not have all of it */
    /* Of the first page of a message: frames that do not have all of it and of the pages that they
     * select, if it has multiplexers; and frames with a value that no case has. */
    uint64_t short_count;
    uint64_t unknown_count;
} canser_page;

/* A multiplexer: a number whose value selects pages. */
typedef struct {
    canser_field field;
    uint32_t least_dlc; /* shorter frames do not have it */
    uint32_t first_case;
    uint32_t case_count; /* ranges that do not meet, the lowest first */
    uint32_t table;      /* where a table of 256 elements begins, the case of each value and one
                          * more, 0 for none; or CANSER_NO_TABLE */
} canser_mux;

/* Values of a multiplexer, from low to high, and the pages that they select. */
typedef struct {
    uint64_t low;
    uint64_t high;
    uint32_t first_link; /* links are numbers of pages */
    uint32_t link_count;
} canser_case;

/* An id that was seen, or that a message has; in an open hash.
 *
 * Nearly all frames of an id have the same first 8 bytes: id, ext, rtr, dlc and err. So those of
 * the last one that only needed to be counted are kept, and the next frame with the same ones costs
 * little. */
typedef struct {
    uint64_t head;    /* private: the 8 bytes, or CANSER_NO_HEAD */
    uint32_t counter; /* private: where such frames are counted */
    uint32_t key;     /* the id, with bit 31 set if it is an extended one */
    uint32_t page;  /* that of its message and one more; CANSER_NO_MESSAGE; 0: the place is free */
    uint32_t route; /* private */
    uint64_t count; /* frames, if it has no message */
} canser_known_id;

/* A parameter group of J1939, and the message of its frames: priority and source do not count, and
 * the destination does not where it is part of the id. */
typedef struct {
    uint32_t pgn;
    uint32_t page; /* of the message */
} canser_pgn;

/* A database, in the caller's memory, with all that is counted. The caller sets the arrays, and
 * and numbers in them that are in range; it zeroes what is counted. */
typedef struct {
    canser_known_id *ids;
    size_t id_cap; /* a power of two up to 2^31, at least twice the ids of the database */
    uint32_t
        spread; /* any odd number: an id's place is in the upper bits of their product. One that
                 * is not known before keeps ids from being made that meet in few places */
    size_t id_count;
    size_t id_most; /* further ids are not kept: their frames are decoded, but not told apart */
    const canser_pgn *pgns; /* the smallest first */
    size_t pgn_count;
    canser_page *pages;
    size_t page_count;
    uint64_t *dlcs; /* counted: frames of a page by their dlc, 9 for each page */
    const canser_mux *muxes;
    const canser_case *cases;
    const uint32_t *links;
    const uint16_t *tables;
    canser_group *groups;
    size_t group_count;
    canser_cursor **cursors; /* private: that of a page's group, if it is the only one */
    canser_cursor nowhere;   /* private: that of all other pages, without room */
    uint32_t is_past;        /* private: whether columns are stored past the cache */
    uint32_t is_wide;        /* private: and by AVX2 */
    const canser_signal *signals;
    uint64_t remote_count; /* remote frames, which have no data */
    uint64_t error_count;
    uint64_t other_count; /* frames without a message whose id is not kept, or has over 29 bits */
} canser_database;

/* Count the frames of each id, message and page: so the caller learns what room each group needs.
 * routes[i] tells canser_database_decode() where frames[i] belongs.
 *
 * Stops before a frame with a new id if half of the places for ids are used: then `*used` is less
 * than `frame_count`, and the caller goes on after canser_database_move_ids(). Returns CANSER_OK;
 * CANSER_NULL, CANSER_MISALIGNED, or CANSER_RANGE for an unfit id_cap, before anything was done. */
int canser_database_count(canser_database *self, const canser_frame *frames, size_t frame_count,
                          uint16_t *routes, size_t *used);

/* Decode the frames into the columns of their groups, behind what is there, by the routes that
 * canser_database_count() has set for them. It counts nothing else.
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED or CANSER_RANGE as above; CANSER_RANGE also
 * when a group has no room: then the columns are incomplete. */
int canser_database_decode(canser_database *self, const canser_frame *frames, size_t frame_count,
                           const uint16_t *routes);

/* Move the ids to a table of zeros with `id_cap` places, a power of two. The table before may be
 * just a row of ids, of any number. Returns CANSER_OK, CANSER_NULL or CANSER_RANGE. */
int canser_database_move_ids(canser_database *self, canser_known_id *ids, size_t id_cap);

/* ---- For signals: their values at other times than their own. */

/* The samples of a signal. */
typedef struct {
    const int64_t *ts;  /* rising; of samples of equal times the last one counts */
    const void *values; /* 8 bytes each; need not be aligned */
    size_t count;
} canser_samples;

/* The times for which values are asked. */
typedef struct {
    const int64_t *times; /* rising, and equal times are allowed; NULL: first + i * step */
    int64_t first;
    int64_t step; /* 1 or more, if `times` is NULL */
    size_t count;
} canser_grid;

/* Copy the value of the last sample at or before each time of a grid to `out`, 8 bytes each.
 * valid[i] is 1 if there is such a sample, and it is at most `max_age` nanoseconds old; otherwise
 * it is 0, and `missing` is copied.
 *
 * `out` and `valid` share no byte with each other and with the samples. If the times of the samples
 * or of the grid do not rise, some samples are passed over, and nothing else happens.
 *
 * Returns CANSER_OK; before anything was written CANSER_NULL, CANSER_MISALIGNED, or CANSER_RANGE
 * for a step of less than 1, or times of the grid above INT64_MAX. Arrays may be NULL if their
 * count is 0. */
int canser_resample_previous(const canser_samples *samples, const canser_grid *grid,
                             uint64_t max_age, uint64_t missing, void *out, uint8_t *valid);

/* The same, but all values are double, and lie on the line from the last sample at or before a
 * time to the first one behind it. At the time of a sample it is the sample's own value. Between
 * two samples there is no value if they are more than `max_age` nanoseconds apart; and none in
 * front of the first sample, and behind the last one. */
int canser_resample_linear(const canser_samples *samples, const canser_grid *grid, uint64_t max_age,
                           uint64_t missing, void *out, uint8_t *valid);

/* Set `*rise` to 1 if no time is before the one in front of it, else to 0. Returns CANSER_OK,
 * CANSER_NULL or CANSER_MISALIGNED. */
int canser_times_rise(const int64_t *ts, size_t count, uint8_t *rise);

/* ---- For tables of other programs: frames and other records as columns of Arrow. */

/* How the values of a column are copied. */
enum {
    CANSER_COLUMN_VALUES,    /* `size` bytes each */
    CANSER_COLUMN_FLAGS,     /* a byte each, of which a bit is made: 1 unless it is 0 */
    CANSER_COLUMN_LIST,      /* `size` bytes each, as a list of numbers of fixed length */
    CANSER_COLUMN_TEXT,      /* UTF-8, up to `size` bytes each, with zero bytes behind it */
    CANSER_COLUMN_DICTIONARY /* int32_t, each the index of one of `texts` */
};

/* Which values of a column are null. */
enum {
    CANSER_NULLS_NONE,
    CANSER_NULLS_ALL,
    CANSER_NULLS_NO_TIME,    /* CANSER_NO_TIME, of int64_t */
    CANSER_NULLS_NO_CHANNEL, /* CANSER_NO_CHANNEL, of uint8_t */
    CANSER_NULLS_NAN,        /* of double */
    CANSER_NULLS_MASK        /* those whose byte in `mask` is 0 */
};

/* Memory that arrays and columns of tables own together: the last one that is released frees it. */
typedef struct canser_block canser_block;

/* The texts of a dictionary, different ones: UTF-8, one behind the other. */
typedef struct {
    const char *bytes;
    const int32_t *ends; /* of `count` + 1 numbers the first is 0; the others are where texts end */
    size_t count;
} canser_texts;

/* A column of an array of records. */
typedef struct {
    const char *name;
    const char *format;        /* of its type in Arrow, such as "I"; of a list "+w:" and `size` */
    const void *values;        /* the first one; need not be aligned */
    ptrdiff_t stride;          /* bytes from one value to the next; may be negative */
    size_t size;               /* of a value */
    int kind;                  /* CANSER_COLUMN_* */
    int nulls;                 /* CANSER_NULLS_* */
    const uint8_t *mask;       /* of CANSER_NULLS_MASK, a byte for each value */
    const canser_texts *texts; /* of CANSER_COLUMN_DICTIONARY */
    const void *metadata;      /* of the field, encoded as Arrow tells; NULL: there is none */
    size_t metadata_len;
    canser_block *block; /* has the values, which the table shares; NULL: they are copied */
} canser_column;

/* Records as columns, in memory that never changes. The caller, and all structs
 * that were made of the table, own it together: the last one that is released frees it. */
typedef struct canser_table canser_table;

/* The structs of Arrow's C interfaces, see arrow.apache.org/docs/format/CDataInterface.html. Their
 * release callbacks may be called in any order, from any thread, and when nothing else of canser
 * is in use. */
struct ArrowSchema;
struct ArrowArray;
struct ArrowArrayStream;

/* Make a block of `size` bytes, which are not set. They begin at a multiple of 64.
 *
 * Returns CANSER_OK, and the caller releases `*block`; CANSER_NULL or CANSER_NO_MEMORY, and
 * `*block` is NULL. */
int canser_block_new(size_t size, canser_block **block);

/* The bytes of a block, which are good as long as it is owned. */
uint8_t *canser_block_values(const canser_block *self);

/* Own the block once more, tell how many own it, and release it, once. NULL is allowed. */
void canser_block_share(canser_block *self);
size_t canser_block_owners(canser_block *self);
void canser_block_release(canser_block *self);

/* Copy columns, with their names, formats and metadata, into a new table. Values that lie in a
 * block, one behind the other, are not copied: the table owns the block once more. The caller does
 * not write to them as long as it does.
 *
 * Returns CANSER_OK, and the caller releases `*table`; CANSER_NULL, CANSER_NO_MEMORY, or
 * CANSER_RANGE for an unknown kind, a size that does not fit it, or values that do not lie in their
 * block, and `*table` is NULL. `values` may be NULL if `row_count` is 0. The formats, the metadata
 * and the indices of a dictionary are not checked. */
int canser_table_new(const canser_column *columns, size_t column_count, size_t row_count,
                     canser_table **table);

/* Own the table once more: it is released once more, too. NULL is allowed. */
void canser_table_share(canser_table *self);

/* Find the values of a column, which are good as long as the table is owned, and the bits of those
 * that are not null, the first one lowest; NULL: none is null. Returns CANSER_OK, CANSER_NULL or
 * CANSER_RANGE. */
int canser_table_column(const canser_table *self, size_t index, const uint8_t **values,
                        const uint8_t **valid);

/* Release the table, once. NULL is allowed. */
void canser_table_release(canser_table *self);

/* Export the table without a copy: its schema, a struct array of all rows, and a stream whose one
 * batch is this array. The table may be released before they are.
 *
 * The caller gives the struct back by the function below, once. Before it may hand the struct to
 * another program, which moves its content away as Arrow's specification tells: copies it, and sets
 * `release` to NULL. Returns CANSER_OK; CANSER_NULL or CANSER_NO_MEMORY, and the pointer is NULL.
 */
int canser_table_schema(canser_table *self, struct ArrowSchema **schema);
int canser_table_array(canser_table *self, struct ArrowArray **array);
int canser_table_stream(canser_table *self, struct ArrowArrayStream **stream);

/* Free a struct that was exported, and release its content if it was not moved away. NULL is
 * allowed. */
void canser_schema_free(struct ArrowSchema *schema);
void canser_array_free(struct ArrowArray *array);
void canser_array_stream_free(struct ArrowArrayStream *stream);

/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
