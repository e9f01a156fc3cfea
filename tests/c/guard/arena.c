#define _DEFAULT_SOURCE /* MAP_ANONYMOUS, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include "arena.h"
#include "checks.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

static arena slots[DRIVE_SLOT_COUNT];

arena arena_new(size_t size)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    arena a = {.size = (size + page - 1) / page * page};
    uint8_t *p = mmap(NULL, a.size + 2 * page, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    if (p == MAP_FAILED || mprotect(p + page, a.size, PROT_READ | PROT_WRITE)) {
        perror("guard: mmap");
        exit(2);
    }
    a.begin = p + page;
    return a;
}

uint8_t *arena_put(const arena *a, size_t size, size_t shift, uint8_t fill)
{
    memset(a->begin, fill, a->size);
    return now.at_end ? a->begin + a->size - size - shift : a->begin + shift;
}

bool arena_is_clean(const arena *a, const uint8_t *p, size_t size, uint8_t fill)
{
    const uint8_t *const end = p + size;

    return is_filled(a->begin, (size_t)(p - a->begin), fill) &&
           is_filled(end, (size_t)(a->begin + a->size - end), fill);
}

void slots_set_up(size_t size)
{
    for (int i = 0; i < DRIVE_SLOT_COUNT; i++)
        slots[i] = arena_new(size);
}

/* The bytes around an array in its arena. For an input it is the end mark that
 * a reader who goes too far would like to find. */
static uint8_t filler(drive_slot slot)
{
    return slot == DRIVE_INPUT ? plain_format_of(now.protocol)->end : UNUSED_BYTE;
}

void *place(drive_slot slot, size_t size)
{
    return arena_put(&slots[slot], size, slot == DRIVE_INPUT ? now.shift : 0, filler(slot));
}

void drop(drive_slot slot, void *p, size_t size)
{
    if (!arena_is_clean(&slots[slot], p, size, filler(slot)))
        check(false, "memory around an array was written");
}

bool is_filled(const void *p, size_t size, uint8_t fill)
{
    const uint8_t *const bytes = p;

    /* All are as the first one if each is as the next one. */
    return size == 0 || (*bytes == fill && memcmp(bytes, bytes + 1, size - 1) == 0);
}

void *behind(void *p, size_t distance)
{
    return (uint8_t *)p + distance;
}
