/* Memory between pages that may not be touched. POSIX only. */
#ifndef ARENA_H
#define ARENA_H

#include "drive.h"

enum {
    UNUSED_BYTE = 0x5A, /* around an array, and in one that nothing has written to */
    SHIFT_MAX = 8       /* of now.shift: all alignments of a word */
};

/* Some pages between two that may not be touched. */
typedef struct {
    uint8_t *begin;
    size_t size;
} arena;

arena arena_new(size_t size);

/* Put `size` bytes against the guard: the one behind the arena where now.at_end says so, else the
 * one before it; `shift` away. */
uint8_t *arena_put(const arena *a, size_t size, size_t shift, uint8_t fill);

/* Whether the arena is as it was, but for the `size` bytes at `p`. */
bool arena_is_clean(const arena *a, const uint8_t *p, size_t size, uint8_t fill);

/* For `drive`, and for every other call: the memory of one call, an arena for each slot. The input
 * lies now.shift away from the guard. */
void slots_set_up(size_t size);
void *place(drive_slot slot, size_t size);
void drop(drive_slot slot, void *p, size_t size);

bool is_filled(const void *p, size_t size, uint8_t fill);

/* The address so many bytes on. */
void *behind(void *p, size_t distance);

#endif
