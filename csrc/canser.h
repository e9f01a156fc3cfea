/* canser: decode and encode the byte streams of serial CAN adapters.
 *
 * Plain C11 without allocation, I/O or globals that change: the caller owns
 * all memory. Return codes are for the caller's mistakes; counters are for what
 * is wrong on the wire. Results are written on every return, errors included:
 * so a caller never reads a count of an earlier call.
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

/* The protocols, in the order of their names, with the bytes of their longest packets. A new one
 * is one C file in protocols/, which defines `canser_protocol_NAME`, and one row here. */
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
 * packet, and what a probe looks at before it knows that a length is good. */
#define CANSER_BEHIND (CANSER_PACKET_MAX + 4)

/* Room for a packet, so that a canser_control has no bytes that belong to no field. */
#define CANSER_CONTROL_ROOM (CANSER_PACKET_MAX / 8 * 8 + 7)

/* Between the two cffi lines stands what Python binds, declared only here. */
/* cffi: begin */

/* ---- For any program: decode, encode, configure an adapter, understand its packets. */

/* Status codes: the caller's mistakes, found before a byte is touched. */
enum {
    CANSER_OK = 0,
    CANSER_NULL = 1,       /* a pointer that must not be NULL is NULL */
    CANSER_MISALIGNED = 2, /* an array does not lie on its element's alignment */
    CANSER_OVERLAP = 3,    /* an output shares bytes with the input or another output */
    CANSER_REFUSED = 4,    /* encode: the format cannot carry a frame */
    CANSER_TICK = 5,       /* tick_ns is less than 1 */
    CANSER_MISMATCH = 6,   /* join: the chunk does not begin where the stream stands */
    CANSER_UNABLE = 7,     /* configure: the adapter takes no configuration */
    CANSER_RANGE = 8,      /* a value is none that the adapter, or the call, can have */
    CANSER_NO_CONTROL = 9  /* explain: the bytes are not one whole control packet */
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

/* How an adapter takes part in its bus. */
enum {
    CANSER_MODE_NORMAL,
    CANSER_MODE_LOOPBACK, /* hears what it sends itself */
    CANSER_MODE_SILENT,   /* listens, and never drives the bus: no acknowledgement either */
    CANSER_MODE_LOOPBACK_SILENT,
    CANSER_MODE_COUNT
};

/* What a control packet is. */
enum {
    CANSER_CONTROL_OTHER, /* no document says what it means */
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

/* One packet that is valid but is no CAN frame. */
typedef struct {
    uint64_t offset;                    /* of its first byte in the stream */
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
    uint64_t ts_uncertain;                 /* of these, those of over 2^24 ticks from a clock in
                                            * line: a restart, a silence of more than half a turn,
                                            * or a false time */
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
    uint32_t baudrate;                /* of the serial line, as adapters come, in bit/s */
    const uint32_t *bitrates;         /* of the bus, in bit/s, that an adapter can be configured
                                       * to, 0 behind the last; NULL: it takes no configuration */
    canser_packet ping;               /* comes straight back */
    canser_packet status_request;     /* is answered by a status packet */
    const struct canser_codec *codec; /* private */
} canser_protocol;

/* How an adapter is to work. */
typedef struct {
    uint32_t bitrate;     /* of the bus, in bit/s: one of the row's */
    uint32_t filter_id;   /* of the frames that pass, where the mask has a 1 */
    uint32_t filter_mask; /* 0: all frames pass */
    uint8_t mode;         /* CANSER_MODE_* */
    uint8_t ext_only;     /* 1: receives extended frames only; 0: both kinds */
    uint8_t once;         /* 1: sends no frame again that was not acknowledged */
    uint8_t fixed;        /* 1: reports frames in packets of a fixed length */
} canser_config;

/* What a control packet says. Fields that its kind does not have are zero. */
typedef struct {
    int kind;                /* CANSER_CONTROL_* */
    uint8_t receive_errors;  /* STATUS: the adapter's receive error counter */
    uint8_t transmit_errors; /* STATUS: its transmit error counter */
    uint8_t number;          /* ERROR: what has happened, by the adapter's own numbers */
    canser_config config;    /* CONFIGURATION */
} canser_report;

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
    int64_t *ends;            /* stream offset behind each, as long; or NULL */
    canser_control *controls; /* or NULL: control packets are counted, not kept */
    size_t control_cap;
    size_t frame_count;
    size_t control_count;
} canser_batch;

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

/* What frames are called that are refused for a reason, where they are counted: a plural,
 * constant. NULL if there is no such refusal. */
const char *canser_refusal_name(int refusal);

/* The name of a mode, and of a kind of control packets: lower case, constant. NULL
 * if there is none such. */
const char *canser_mode_name(int mode);
const char *canser_control_name(int kind);

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

/* Tell of each of some frames why the format cannot carry it, as canser_encode() would:
 * refusals[i] is CANSER_REFUSAL_*, NONE where it can; CANSER_REFUSAL_TIME only where there is
 * no other reason.
 *
 * Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and CANSER_OVERLAP before anything was
 * written. `refusals` has room for `frame_count`; it and `frames` may be NULL if that is 0. */
int canser_refuse(const canser_protocol *protocol, const canser_frame *frames, size_t frame_count,
                  uint8_t *refusals);

/* Make the packet that configures an adapter. Any flag but 0 counts as 1.
 *
 * Returns CANSER_OK; CANSER_NULL; CANSER_UNABLE where the row has no bit rates;
 * CANSER_RANGE for a bit rate that is none of them, no mode, or a filter or mask over
 * 0x1FFFFFFF. `*packet` is set on every return on which it is not NULL, to none after
 * an error. */
int canser_configure(const canser_protocol *protocol, const canser_config *config,
                     canser_packet *packet);

/* Tell what a control packet means: `len` bytes that are one, as a decoder gave it.
 *
 * The same bytes mean the same in both directions: a request for the status reads as
 * a status without errors. What the format leaves open is CANSER_CONTROL_OTHER: unknown
 * commands, and configurations with a value that canser_configure() never sends, but
 * for filter and mask, of which all 32 bits are told.
 *
 * Returns CANSER_OK; CANSER_NULL; CANSER_NO_CONTROL where the bytes are a frame, noise,
 * cut, or more than one packet. `*report` is set on every return on which it is not NULL,
 * to OTHER after an error. */
int canser_explain(const canser_protocol *protocol, const uint8_t *packet, size_t len,
                   canser_report *report);

/* ---- For the binding, and programs that do as much: parts of a stream by several threads, host
 * times, recordings, one decoder for several threads. */

/* The frames in which a chunk's clock must settle to be joined. */
#define CANSER_SETTLE_MAX 64

/* The longest that a byte may take on a line: 5 bits a second. */
#define CANSER_BYTE_NS_MAX 2000000000

/* Of so many frames of a piece all but one may be false, and its sample is a true one. */
#define CANSER_LEAST_LATE 3

/* A stretch of a stream that was decoded from a guess where its first packet starts. It is joined
 * to the stream when all that lies before it is decoded: that is how several threads decode one
 * stream. Lives in the caller's memory; all fields but the three that say so are private. */
typedef struct {
    uint64_t begin;         /* for the caller: the stream offset at which it starts, a guess */
    uint64_t end;           /* for the caller: the stream offset behind it */
    size_t frame_count;     /* for the caller: its frames */
    canser_decoder decoder; /* of the stretch alone, as if it were a stream */
    uint8_t skips_first;    /* 1: no packet starts at `begin` */
    size_t settled;         /* joined: so many frames have their times */
    int64_t shift;          /* joined: nanoseconds to add to the times of the others */
    uint32_t raws[CANSER_SETTLE_MAX]; /* device timestamps of the first frames */
} canser_chunk;

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
 * CANSER_MISMATCH, and nothing was changed, if the stream does not stand at chunk->begin,
 * holds bytes, is of another protocol or unit, or if the device clock leaps so often that
 * it cannot be told what it does in the chunk. */
int canser_decoder_join(canser_decoder *self, canser_chunk *chunk, canser_frame *frames);

/* Copy frames[first..first + frame_count) of a joined chunk to `out`, with their times.
 * Where they lie there already they get their times; otherwise the two must not overlap.
 * Works on its own arguments alone: meanwhile the stream may go on. Returns CANSER_OK or
 * CANSER_NULL. */
int canser_chunk_deliver(const canser_chunk *self, canser_frame *frames, size_t first,
                         size_t frame_count, canser_frame *out);

/* The bytes of one read of a port, behind those of the read before. */
typedef struct {
    int64_t end; /* stream offset behind them */
    int64_t ns;  /* when they had come */
} canser_piece;

/* The least late frame of a piece: its time by the device's clock, and when it had come. */
typedef struct {
    int64_t device;
    int64_t arrival;
    int64_t counted; /* by how much it was counted back from the last frame of the piece */
} canser_sample;

/* The frames of a piece with the lowest arrival less device time, the lowest first; of equal ones
 * the first ones. Private. */
typedef struct {
    size_t count;
    canser_sample frames[CANSER_LEAST_LATE];
} canser_least_late;

/* Which turn of its counter a device's clock is in. Private. */
typedef struct {
    int64_t shift;      /* nanoseconds to add to a decoder's time */
    int64_t delay;      /* arrival less device time of the last frame that was near those before */
    int64_t last_delay; /* of the last one that was not */
    uint8_t run;        /* how many of these in a row were near each other */
    uint8_t started;    /* 1: `delay` and `shift` are set */
} canser_turns;

/* What a device's clock stands at: host's time = host + run + run * drift, where run =
 * device time - device; rounded towards `host + run`, modulo 2^64. */
typedef struct {
    int64_t device;
    int64_t host;
    double drift; /* between -1 and 1 */
} canser_line;

/* Which times a line gives are believed. */
typedef struct {
    int64_t reached; /* a device time that the clock had come to */
    int64_t early;   /* 0 or more: how far a device time may lie before that one, and a host
                      * time behind its arrival */
    int64_t late;    /* 0 or more: how far a host time may lie before its arrival */
} canser_trust;

/* Why canser_timing_assign() has returned. */
enum {
    CANSER_TIMING_DONE = 0,    /* all frames have their times */
    CANSER_TIMING_BUCKET = 1,  /* the samples are enough to learn from */
    CANSER_TIMING_FULL = 2,    /* there is no room for another sample */
    CANSER_TIMING_SILENCE = 3, /* the next frame comes after a silence */
};

/* How the frames of one stream get their times. Zero it, and set the fields that are not private;
 * those marked "any time" may be set between any two calls. */
typedef struct {
    int64_t tick_ns;      /* the unit of the device's times, at most INT32_MAX; 0: it sends none */
    uint8_t keeps_device; /* 1: frames keep the device's time, but for its turn */
    int64_t silence_ns;   /* between two arrivals: more stops a call */
    int64_t bucket_ns;    /* samples are enough when this lies between the first and the last, */
    size_t bucket_least;  /* and there are so many of them; */
    size_t bucket_most;   /* any time: or when there are so many */
    double byte_ns;       /* any time: what a byte takes on the line, 0 to CANSER_BYTE_NS_MAX */
    canser_line line;     /* any time: what the device's clock stands at, */
    uint8_t has_line;     /* any time: 1: if that is known */
    canser_trust trust;   /* any time */
    canser_sample *samples; /* any time: room for samples, */
    size_t sample_cap;      /* any time: for so many; may be NULL if that is 0 */
    size_t sample_count;    /* any time: samples in it. Each call adds some */
    int stopped;            /* CANSER_TIMING_*: why the last call has returned */
    /* Private. */
    canser_turns turns;
    canser_least_late least_late; /* of the piece that the last frame was in */
    int64_t piece_end;            /* of that piece */
    int64_t arrived;              /* when the last frame had come */
    int64_t latest;               /* no host time lies before this one */
} canser_timing;

/* Set the times of frames[*done..count), the next ones of a stream, in place. `*done` is raised as
 * frames get them.
 *
 * at[i] is the stream offset of a frame's first byte where the device sends times, else the one
 * behind its last byte: the first or the last byte is the one that counts. It came with the first
 * piece that ends behind it; as much before pieces[].ns as the rest of that piece takes on the
 * line, rounded down, but not before the piece before. So pieces[0] only tells when the next one
 * began, unless a byte asked for lies in it. Behind the last piece all bytes have its time.
 * Without times of a device that is all, and frames[i].ts may be anything.
 *
 * Else frames[i].ts is what a decoder with the same `tick_ns` gave. A counter of 32 bits tells a
 * time but for whole turns; the host's clock tells the turn, as long as the arrival is late by
 * less than half a turn: after a silence of any length, and whatever false times came before. The
 * first frame keeps the value of its counter. A frame then has
 *
 * - with keeps_device that time of the device;
 * - while no line is known, or where what it gives is not believed, its arrival;
 * - else the host's time by the line, but none behind its arrival, and none before any other that
 *   a line gave, or before the last arrival without one.
 *
 * Each piece with a frame gives a sample, of which an estimate of the device's clock can learn:
 * its frame with the lowest arrival less device time. False frames have any device time: so one of
 * the two lowest that is lower than the next one by over a minute does not count. A sample is
 * given once a frame of a later piece is at hand; before that frame a call stops when the samples
 * are enough or their room is full, and so it does before the first frame after a silence. The
 * caller changes what it learns, and calls again with the rest.
 *
 * Pieces and offsets are in ascending order, no piece has 2^32 bytes, and no device has run for
 * 2^63 nanoseconds, else the times are of no use. What comes out does not depend on how frames
 * are cut into calls. Returns CANSER_OK; CANSER_NULL (also for no pieces), CANSER_MISALIGNED,
 * CANSER_TICK or CANSER_RANGE before anything is written. */
int canser_timing_assign(canser_timing *self, const canser_piece *pieces, size_t piece_count,
                         const int64_t *at, canser_frame *frames, size_t count, size_t *done);

/* Which blocks of a recording canser_recording_gather() takes. The caller sets the first three
 * fields; a call goes on with next_id as the call before has left it. */
typedef struct {
    uint64_t next_id;         /* of the next block, if nothing is missing before it */
    uint32_t interface;       /* the number of the interface in the file */
    uint8_t has_ids;          /* 1: blocks have ids; 0: drop counts instead, in old files */
    uint32_t crc32s[16][256]; /* private: the CRC32 of a byte with 0 to 15 zeros behind it */
} canser_recording;

/* What canser_recording_gather() did. */
typedef struct {
    size_t used;        /* bytes of the file: where it stopped, between two blocks */
    size_t byte_count;  /* bytes of the line */
    size_t piece_count; /* blocks */
} canser_gathered;

/* Set up what does not change from call to call. Returns CANSER_OK or CANSER_NULL. */
int canser_recording_init(canser_recording *self);

/* Gather the bytes of the line from the blocks of a recording, one behind the other.
 *
 * Takes blocks from data[0] on as long as nothing is unusual about them: a little-endian enhanced
 * packet block of the interface, with at least one byte, as RecordingWriter writes it; the CRC32
 * holds, its id is the next one, or where there are no ids its drop count is 0; there is no
 * comment, and its time is less than 2^63. Stops before any other block, one that is not whole in
 * data, one whose bytes do not fit into `out`, and where `pieces` is full. It stops before some
 * block that is good: the caller takes that one by itself.
 *
 * pieces[i] has the end of block i's bytes in `out`, and its time. Bytes of `out` past
 * byte_count may have been written over. Returns CANSER_OK; CANSER_NULL, CANSER_MISALIGNED and
 * CANSER_OVERLAP before anything was written. An array may be NULL if its length is 0. `*result`
 * is set on every return on which it is not NULL. */
int canser_recording_gather(canser_recording *self, const uint8_t *data, size_t data_len,
                            uint8_t *out, size_t out_cap, canser_piece *pieces, size_t piece_cap,
                            canser_gathered *result);

/* A decoder that several threads may use, for a binding to a language in which each call is
 * expensive. While one thread works on it, the calls of others return at once, and must be tried
 * again. */
typedef struct {
    canser_decoder
        decoder; /* to change only between take and release, below; to read at any time */
    uint8_t
        keeps_controls; /* for the caller: 1: canser_stream_feed() leaves control packets to it */
    uint32_t taken;     /* private: what works on it */
} canser_stream;

/* The most bytes of one small call: other threads may wait until it ends. */
#define CANSER_SMALL_MAX 1048576

/* Take the stream; calls with its decoder are the caller's alone until canser_stream_release().
 * Returns 1, or 0 where another caller has it. */
int canser_stream_take(canser_stream *self);

/* Give back what canser_stream_take() took, if it did. */
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
 * All or nothing. Returns the number of frames. Where `frames` is full, the bytes that were not
 * taken, times 2^32, are added. Returns -1, and nothing is changed but rows of the arrays, where
 * another call is needed to tell why, or to do it: the stream is taken; an argument is wrong; there
 * are over CANSER_SMALL_MAX bytes; a control packet is among them that must be kept. */
int64_t canser_stream_feed(canser_stream *self, const uint8_t *data, size_t data_len,
                           const canser_target *target);

/* Decode a whole stream. Returns the number of frames, plus 2^32 times the skipped bytes; -1
 * where an argument is wrong, there are over CANSER_SMALL_MAX bytes, or `frames` has become full.
 */
int64_t canser_decode_small(const canser_protocol *protocol, int64_t tick_ns, const uint8_t *data,
                            size_t data_len, canser_frame *frames, size_t frame_cap);

/* cffi: end */

#ifdef __cplusplus
}
#endif

#endif
