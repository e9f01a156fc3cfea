/* Private: stores past the cache, for memory that is not read soon. Other stores read each line of
 * memory before they write over it. */
#ifndef CANSER_PAST_H
#define CANSER_PAST_H

#include "protocol.h"

#if defined(__x86_64__)
#include <emmintrin.h>
#define CANSER_HAS_PAST 1
#else
#define CANSER_HAS_PAST 0
#endif

CANSER_INLINE void store_past(void *to, uint64_t word)
{
#if CANSER_HAS_PAST
    _mm_stream_si64(to, (long long)word);
#else
    memcpy(to, &word, sizeof word);
#endif
}

/* Copy words to a place that is aligned for them. */
CANSER_INLINE void copy_past(uint64_t *restrict to, const uint64_t *restrict from, size_t count)
{
#if CANSER_HAS_PAST
    size_t i = 0;

    if ((uintptr_t)to % 16 && count)
        store_past(&to[i], from[i]), i++;
    for (; i + 2 <= count; i += 2)
        _mm_stream_si128((__m128i *)(void *)&to[i],
                         _mm_loadu_si128((const __m128i *)(const void *)&from[i]));
    if (i < count)
        store_past(&to[i], from[i]);
#else
    memcpy(to, from, count * sizeof *to);
#endif
}

/* Make stores past the cache visible to other threads. */
CANSER_INLINE void settle_stores(void)
{
#if CANSER_HAS_PAST
    _mm_sfence();
#endif
}

#endif
