/* Random numbers, the same in every run. */
#ifndef CHANCE_H
#define CHANCE_H

#include <stddef.h>
#include <stdint.h>

/* A number of 56 bits. */
uint64_t random_word(void);

size_t random_below(size_t bound);

#endif
