/* Random numbers, and memory behind which a page may not be touched: for the tests of files.
 * Included before all else. POSIX only. */
#ifndef GUARDED_H
#define GUARDED_H

#define _DEFAULT_SOURCE /* MAP_ANONYMOUS, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

/* Random numbers, the same in every run: xorshift64*. */
static uint64_t random_state = 0x9E3779B97F4A7C15;

static uint64_t random_word(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return random_state * 0x2545F4914F6CDD1D;
}

static size_t random_below(size_t bound)
{
    return (size_t)((random_word() >> 16) % bound);
}

/* The end of `size` bytes behind which a page may not be touched. */
static uint8_t *guarded(size_t size)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE), pages = (size + page - 1) / page * page;
    uint8_t *const p = mmap(NULL, pages + page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    if (p == MAP_FAILED || mprotect(p, pages, PROT_READ | PROT_WRITE)) {
        perror("mmap");
        exit(2);
    }
    return p + pages;
}

#endif
