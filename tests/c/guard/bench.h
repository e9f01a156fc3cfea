/* What a caller's mistakes are tried on, one after the other, for each protocol. */
#ifndef BENCH_H
#define BENCH_H

#include "canser.h"

/* A decoder in the middle of a stream, and arrays to fill. */
typedef struct {
    canser_decoder decoder, before;
    canser_batch batch;
    size_t used;
    union {
        canser_frame frames[4];
        uint8_t bytes[4 * sizeof(canser_frame)];
    } memory;
    int64_t offsets[4];
    int64_t ends[4];
    canser_control controls[4];
    uint8_t data[64];
} bench;

/* Set all up anew for now.protocol: one byte is held, and a clean stream goes on at data[1]. */
void set_bench(bench *b);

/* Check that no array was written to since the bench was as `before`. */
void check_arrays_kept(const bench *b, const bench *before);

#endif
