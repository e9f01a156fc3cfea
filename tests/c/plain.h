/* A second opinion on the wire formats: the scan of a whole stream and the
 * encoding of one frame, written from the descriptions of the formats and
 * never from csrc. One position after the other, nothing carried, no speed:
 * it is there to be read and believed.
 *
 * It shares with csrc only the records and the numbers of canser.h.
 */
#ifndef PLAIN_H
#define PLAIN_H

#include "canser.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* In the order of canser_protocol_at: PLAIN_serial and so on. */
#define PLAIN_NUMBER(name, packet_max) PLAIN_##name,
enum { CANSER_PROTOCOLS(PLAIN_NUMBER) PLAIN_PROTOCOL_COUNT };
#undef PLAIN_NUMBER

/* What the tests know of a protocol. */
typedef struct {
    const char *name;
    bool has_clock;
    bool has_ext; /* extended frames */
    bool has_err; /* error frames */
    bool has_bitrates;
    uint32_t baudrate;
    const char *alphabet; /* 8 bytes that mean something; a candidate may start with the first */
    uint8_t end;          /* the last byte of a frame, where it has an end mark */
} plain_format;

const plain_format *plain_format_of(int protocol);

/* A stream and all that is found in it. The caller owns the arrays, each with
 * `row_cap` rows; a stream of n bytes never needs more than n / 2 + 1. The
 * program aborts where they are too small. */
typedef struct {
    int protocol;
    int64_t tick_ns;

    canser_frame *frames;
    int64_t *offsets; /* of each frame in the stream */
    int64_t *ends;    /* behind each frame */
    canser_control *controls;
    size_t row_cap;
    size_t frame_count;
    size_t control_count;

    canser_stats stats;
    size_t pending; /* bytes at the end that need more bytes */

    bool skipping;      /* the last byte was a skipped one */
    bool started;       /* a frame with a time has been seen */
    size_t small_steps; /* of the clock, forward, in a row */
    bool near_line;     /* they began at a frame near the line */
    bool has_line;      /* a frame has stood in line: behind 16 small steps, or near the line */
    size_t behind_line; /* frames behind the last one that did */
    uint64_t line;      /* the ticks of the last one */
    uint32_t raw;       /* the counter of the last frame as it came */
    uint64_t ticks;     /* its time, unwrapped */
} plain_stream;

/* Start a stream of which nothing has been seen. The arrays stay as the caller
 * has set them. */
void plain_begin(plain_stream *self, int protocol, int64_t tick_ns);

/* Scan `bytes`, to the end of the stream or up to the first candidate that
 * needs more bytes. After the end it may be called again: the stream goes on
 * with the same counters and offsets. */
void plain_scan(plain_stream *self, const uint8_t *bytes, size_t len, bool end);

/* Encode one frame into `out`. Returns the length of the packet, or 0 and why in
 * `*refusal`. */
size_t plain_encode(int protocol, int64_t tick_ns, const canser_frame *frame,
                    uint8_t out[CANSER_PACKET_MAX], int *refusal);

#endif
