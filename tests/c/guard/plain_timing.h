/* A second opinion on the times of frames, written from canser.h and never from csrc. */
#ifndef PLAIN_TIMING_H
#define PLAIN_TIMING_H

#include "canser.h"

/* A number of 64 bits as a signed one. */
int64_t plain_wrap(uint64_t value);

/* When the byte at an offset arrived. */
int64_t plain_arrival(const canser_piece *pieces, size_t piece_count, double byte_ns, int64_t at);

/* Device times by arrivals: the last frame that was near those before it tells the turn, or 16 in
 * a row that are near each other. */
void plain_turns(const int64_t *counters, const int64_t *arrivals, size_t count, int64_t tick_ns,
                 int64_t *device);

/* One sample of each piece but the last. Returns how many. */
size_t plain_samples(const canser_piece *pieces, size_t piece_count, const int64_t *at,
                     const int64_t *device, const int64_t *arrivals, size_t count,
                     canser_sample *samples);

/* The host's times by the line. */
void plain_map(const canser_timing *timing, const int64_t *device, const int64_t *arrivals,
               size_t count, canser_frame *frames);

#endif
