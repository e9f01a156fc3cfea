#include "chance.h"

/* xorshift64*. */
static uint64_t state = 0x9E3779B97F4A7C15;

uint64_t random_word(void)
{
    state ^= state >> 12;
    state ^= state << 25;
    state ^= state >> 27;
    return state * 0x2545F4914F6CDD1D >> 8;
}

size_t random_below(size_t bound)
{
    return (size_t)(random_word() % bound);
}
