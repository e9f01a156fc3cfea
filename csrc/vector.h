/* Private: one question put to 64 bytes at once, answered by the bits of a word.
 *
 * Only what looks for the next packet behind a reject uses this: nowhere else do
 * vectors pay. SSE2 and NEON are there on every x86-64 and every 64-bit Arm, so
 * nothing is chosen at run time. -DCANSER_PORTABLE turns it off, and what is not
 * built with GCC or clang does without.
 */
#ifndef CANSER_VECTOR_H
#define CANSER_VECTOR_H

#include "protocol.h"

#if defined(CANSER_PORTABLE) || !defined(__GNUC__) || CANSER_BIG_ENDIAN
#define CANSER_VECTOR 0
#elif defined(__SSE2__)
#define CANSER_VECTOR 1
#include <emmintrin.h>
#elif defined(__aarch64__)
#define CANSER_VECTOR 1
#include <arm_neon.h>
#else
#define CANSER_VECTOR 0
#endif

#if CANSER_VECTOR

/* Positions in one answer. */
enum { SURVEY = 64 };

/* What a wire format says of SURVEY positions. At each one that is in neither mask
 * the first byte alone rejects it, for the first of the format's two reasons. */
typedef struct {
    uint64_t open;   /* bit i: a packet may start at i, probe() must tell */
    uint64_t second; /* bit i: none starts at i, for the second reason */
} surveyed;

#if defined(__SSE2__)

typedef __m128i vec;

CANSER_INLINE vec vec_load(const uint8_t *p)
{
    return _mm_loadu_si128((const __m128i *)(const void *)p);
}

CANSER_INLINE vec vec_fill(uint8_t byte)
{
    return _mm_set1_epi8((char)byte);
}

CANSER_INLINE vec vec_and(vec a, vec b)
{
    return _mm_and_si128(a, b);
}

CANSER_INLINE vec vec_equal(vec a, vec b)
{
    return _mm_cmpeq_epi8(a, b);
}

CANSER_INLINE vec vec_at_most(vec a, vec b)
{
    return _mm_cmpeq_epi8(_mm_min_epu8(a, b), a);
}

/* The answers of four times 16 bytes, one bit each. */
CANSER_INLINE uint64_t vec_bits(vec a, vec b, vec c, vec d)
{
    return (uint64_t)(uint32_t)_mm_movemask_epi8(a) |
           (uint64_t)(uint32_t)_mm_movemask_epi8(b) << 16 |
           (uint64_t)(uint32_t)_mm_movemask_epi8(c) << 32 |
           (uint64_t)(uint32_t)_mm_movemask_epi8(d) << 48;
}

#else

typedef uint8x16_t vec;

CANSER_INLINE vec vec_load(const uint8_t *p)
{
    return vld1q_u8(p);
}

CANSER_INLINE vec vec_fill(uint8_t byte)
{
    return vdupq_n_u8(byte);
}

CANSER_INLINE vec vec_and(vec a, vec b)
{
    return vandq_u8(a, b);
}

CANSER_INLINE vec vec_equal(vec a, vec b)
{
    return vceqq_u8(a, b);
}

CANSER_INLINE vec vec_at_most(vec a, vec b)
{
    return vcleq_u8(a, b);
}

/* The answers of four times 16 bytes, one bit each: a weight for each lane, then
 * sums of neighbours until eight lanes have become one byte. */
CANSER_INLINE uint64_t vec_bits(vec a, vec b, vec c, vec d)
{
    static const uint8_t weights[16] = {1, 2, 4, 8, 16, 32, 64, 128, 1, 2, 4, 8, 16, 32, 64, 128};
    const vec weight = vld1q_u8(weights);
    const vec ab = vpaddq_u8(vandq_u8(a, weight), vandq_u8(b, weight));
    const vec cd = vpaddq_u8(vandq_u8(c, weight), vandq_u8(d, weight));
    const vec abcd = vpaddq_u8(ab, cd);
    return vgetq_lane_u64(vreinterpretq_u64_u8(vpaddq_u8(abcd, abcd)), 0);
}

#endif

/* Bit i: whether p[i] is `byte`. */
CANSER_INLINE uint64_t survey_equal(const uint8_t *p, uint8_t byte)
{
    const vec b = vec_fill(byte);
    return vec_bits(vec_equal(vec_load(p), b), vec_equal(vec_load(p + 16), b),
                    vec_equal(vec_load(p + 32), b), vec_equal(vec_load(p + 48), b));
}

/* Bit i: whether p[i] & mask is at most `limit`. */
CANSER_INLINE uint64_t survey_at_most(const uint8_t *p, uint8_t mask, uint8_t limit)
{
    const vec m = vec_fill(mask), l = vec_fill(limit);
    return vec_bits(
        vec_at_most(vec_and(vec_load(p), m), l), vec_at_most(vec_and(vec_load(p + 16), m), l),
        vec_at_most(vec_and(vec_load(p + 32), m), l), vec_at_most(vec_and(vec_load(p + 48), m), l));
}

/* The number of the lowest bit that is set; `bits` is not 0. */
CANSER_INLINE size_t lowest_bit(uint64_t bits)
{
    return (size_t)__builtin_ctzll(bits);
}

/* How many bits are set. The baselines have no instruction for it. */
CANSER_INLINE size_t count_bits(uint64_t bits)
{
    bits -= bits >> 1 & UINT64_C(0x5555555555555555);
    bits = (bits & UINT64_C(0x3333333333333333)) + (bits >> 2 & UINT64_C(0x3333333333333333));
    bits = (bits + (bits >> 4)) & UINT64_C(0x0F0F0F0F0F0F0F0F);
    return (size_t)(bits * UINT64_C(0x0101010101010101) >> 56);
}

#endif

#endif
