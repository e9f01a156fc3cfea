/* Memory for tables and blocks. This is the one file that allocates.
 *
 * The system clears new pages, which takes as long as decoding signals into them. So large memory
 * that is released is kept for the next one that asks, up to KEPT_MOST bytes. */
#if defined(__linux__) && !defined(_DEFAULT_SOURCE)
#define _DEFAULT_SOURCE /* madvise, where -std=c11 hides it */
#endif

#include "memory.h"

#include "protocol.h"

#include <stdlib.h>

#if defined(__linux__)
#include <sys/mman.h>
#endif

/* A test names its own functions here, to let the first one fail, and to count. */
#ifdef CANSER_MALLOC
void *CANSER_MALLOC(size_t size);
void CANSER_FREE(void *p);
#else
#define CANSER_MALLOC malloc
#define CANSER_FREE   free
#endif

/* From this size on the kernel is asked for large pages, as numpy does: the first use of each page
 * costs more than the writing. Such memory is kept, too. */
enum { LARGE = 1 << 22, PAGE = 1 << 12 };

/* Memory that is kept: how many pieces, and bytes of all. */
enum { PIECES_MOST = 8, KEPT_MOST = 96 << 20 };

/* Lies before each piece; the memory behind it is at a multiple of 16, too. */
typedef union {
    size_t size;
    uint64_t padding[2];
} piece;

/* The pieces that are kept, the oldest one first. */
static struct {
    uint32_t is_busy;
    uint32_t count;
    size_t bytes;
    piece *pieces[PIECES_MOST];
} kept;

/* Begin to use `kept`. False if another thread uses it: none waits. */
CANSER_INLINE bool begin(void)
{
    return CANSER_COMPARE_EXCHANGE(&kept.is_busy, 0, 1);
}

CANSER_INLINE void end(void)
{
    (void)CANSER_COMPARE_EXCHANGE(&kept.is_busy, 1, 0);
}

/* Take the piece at an index out of those that are kept. */
static piece *take(uint32_t index)
{
    piece *const taken = kept.pieces[index];

    kept.bytes -= taken->size;
    kept.count--;
    for (uint32_t i = index; i < kept.count; i++)
        kept.pieces[i] = kept.pieces[i + 1];
    return taken;
}

/* Take the smallest piece that is large enough, if it is at most twice as large; or return NULL. */
static piece *take_kept(size_t size)
{
    uint32_t found = PIECES_MOST;
    piece *taken = NULL;

    if (size < LARGE || !begin())
        return NULL;
    for (uint32_t i = 0; i < kept.count; i++)
        if (kept.pieces[i]->size >= size && kept.pieces[i]->size / 2 <= size &&
            (found == PIECES_MOST || kept.pieces[i]->size < kept.pieces[found]->size))
            found = i;
    if (found < PIECES_MOST)
        taken = take(found);
    end();
    return taken;
}

/* Keep a piece, and free older ones if need be. False if it is not kept. */
static bool keep(piece *made)
{
    if (made->size < LARGE || made->size > KEPT_MOST || !begin())
        return false;
    while (kept.count == PIECES_MOST || kept.bytes > KEPT_MOST - made->size)
        CANSER_FREE(take(0));
    kept.pieces[kept.count++] = made;
    kept.bytes += made->size;
    end();
    return true;
}

/* Free all that is kept. False if there is nothing. */
static bool free_kept(void)
{
    bool has_any;

    if (!begin())
        return false;
    has_any = kept.count > 0;
    while (kept.count)
        CANSER_FREE(take(0));
    end();
    return has_any;
}

void *canser_memory_get(size_t size)
{
    piece *made = take_kept(size);

    if (made)
        return made + 1;
    if (size > SIZE_MAX - sizeof *made)
        return NULL;
    made = CANSER_MALLOC(sizeof *made + size);
    if (!made && free_kept())
        made = CANSER_MALLOC(sizeof *made + size);
    if (!made)
        return NULL;
    made->size = size;
#ifdef MADV_HUGEPAGE
    if (size >= LARGE) {
        const size_t skipped = PAGE - (uintptr_t)made % PAGE;
        /* A kernel without large pages refuses: then they are small. */
        (void)madvise((uint8_t *)made + skipped, sizeof *made + size - skipped, MADV_HUGEPAGE);
    }
#endif
    return made + 1;
}

void canser_memory_release(void *p)
{
    piece *const made = p ? (piece *)p - 1 : NULL;

    if (made && !keep(made))
        CANSER_FREE(made);
}
