/* Drives a decoder of csrc over a stream in pieces, as a caller would, watches
 * the laws of canser.h on every call, and compares what came out with plain.c.
 */
#ifndef DRIVE_H
#define DRIVE_H

#include "plain.h"

/* What a call is given. */
typedef enum {
    DRIVE_DECODER,
    DRIVE_INPUT,
    DRIVE_FRAMES,
    DRIVE_OFFSETS,
    DRIVE_ENDS,
    DRIVE_CONTROLS,
    DRIVE_SLOT_COUNT
} drive_slot;

typedef struct {
    canser_decoder decoder;

    canser_frame *frames;
    int64_t *offsets;
    int64_t *ends;
    canser_control *controls;
    size_t row_cap; /* of each array; one row more than is found must be there */
    size_t frame_count;
    size_t control_count;

    bool no_offsets;  /* pass NULL instead of the array, and of `ends` */
    bool no_ends;     /* pass NULL instead of the array */
    bool no_controls; /* pass NULL instead of the array */

    /* Where each call gets its memory, if not NULL: all that the decoder is
     * given then lives only as long as the call and lies where `place` puts it.
     * `drop` may look at what has happened around it. */
    void *(*place)(drive_slot slot, size_t size);
    void (*drop)(drive_slot slot, void *p, size_t size);

    const char *broken; /* the first law that did not hold, or NULL */
} drive;

/* Start a stream. The arrays and choices stay as the caller has set them. */
void drive_begin(drive *self, int protocol, int64_t tick_ns);

/* Feed a piece, in as many calls as it takes with arrays of `frame_cap` and
 * `control_cap` rows (at least 1). */
void drive_feed(drive *self, const uint8_t *bytes, size_t len, size_t frame_cap,
                size_t control_cap);

/* End the stream, likewise. */
void drive_flush(drive *self, size_t frame_cap, size_t control_cap);

/* What differs from the second opinion, or which law is broken; NULL if nothing
 * and none. */
const char *drive_compare(const drive *self, const plain_stream *expected);

#endif
