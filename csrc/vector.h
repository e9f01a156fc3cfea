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

/* So many candidates are sooner looked at one by one than all positions at once. */
enum { SURVEY_FEW = 8 };

/* What a wire format says of SURVEY positions: bit i of a mask speaks of position i.
 * No position is in two masks. At one that is in none nothing starts, for the one
 * reason of the format, SURVEY_REST, that has no mask. */
typedef struct {
    uint64_t open; /* a packet starts */
    uint64_t type; /* none starts, for the reason of this name; so all that follow */
    uint64_t dlc;
    uint64_t id;
    uint64_t end;
    uint64_t sum;
    uint64_t field;
    uint64_t command;
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

CANSER_INLINE vec vec_or(vec a, vec b)
{
    return _mm_or_si128(a, b);
}

CANSER_INLINE vec vec_add(vec a, vec b)
{
    return _mm_add_epi8(a, b);
}

/* An answer: whether a bit, a constant, is set. vec_bits reads the top bits only. */
CANSER_INLINE vec vec_has(vec a, int bit)
{
    return _mm_slli_epi16(a, 7 - bit);
}

/* The answers of 16 bytes, one bit each. */
CANSER_INLINE uint64_t vec_bits_one(vec a)
{
    return (uint64_t)(uint32_t)_mm_movemask_epi8(a);
}

/* The answers of four times 16 bytes. */
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

CANSER_INLINE vec vec_or(vec a, vec b)
{
    return vorrq_u8(a, b);
}

CANSER_INLINE vec vec_add(vec a, vec b)
{
    return vaddq_u8(a, b);
}

/* An answer: whether a bit, a constant, is set. */
CANSER_INLINE vec vec_has(vec a, int bit)
{
    return vtstq_u8(a, vdupq_n_u8((uint8_t)(1 << bit)));
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

#ifdef __aarch64__
CANSER_INLINE uint64_t vec_bits_one(vec a)
{
    return vec_bits(a, a, a, a) & 0xFFFF;
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

/* Bit i: whether `bit` of p[i] is set. */
CANSER_INLINE uint64_t survey_has(const uint8_t *p, int bit)
{
    return vec_bits(vec_has(vec_load(p), bit), vec_has(vec_load(p + 16), bit),
                    vec_has(vec_load(p + 32), bit), vec_has(vec_load(p + 48), bit));
}

/* Answers for SURVEY positions, and for so many behind them. */
enum { SURVEY_BEHIND = 10 };

typedef struct {
    uint64_t low, high;
} survey_marks;

/* Where `byte` stands. */
CANSER_INLINE survey_marks survey_find(const uint8_t *p, uint8_t byte)
{
    /* 16 bytes that end with the last one asked for: more may not be there. */
    const unsigned repeated = 16 - SURVEY_BEHIND;
    const vec behind = vec_equal(vec_load(p + SURVEY - repeated), vec_fill(byte));
    return (survey_marks){survey_equal(p, byte), vec_bits_one(behind) >> repeated};
}

/* The answers `by` positions further on, by a constant of 0 to SURVEY_BEHIND. */
CANSER_INLINE uint64_t survey_ahead(survey_marks marks, int by)
{
    return marks.low >> by | marks.high << 1 << (63 - by);
}

/* Bit i: whether any answer from i to i + `most` is yes; a constant of 8 to 10. */
CANSER_INLINE uint64_t survey_near(survey_marks marks, const int most)
{
    uint64_t far = 0;

    for (int by = 8; by <= most; by++)
        far |= survey_ahead(marks, by);
    for (int by = 1; by < 8; by *= 2)
        marks = (survey_marks){marks.low | survey_ahead(marks, by), marks.high | marks.high >> by};
    return marks.low | far;
}

/* Bit by bit: b where `choose` is set, else a. */
CANSER_INLINE uint64_t survey_choose(uint64_t choose, uint64_t a, uint64_t b)
{
    return a ^ ((a ^ b) & choose);
}

/* Bit i: the answer n positions ahead of i, where n is a number of four bits for each
 * position, n[0] the lowest ones, and at most `most`, a constant of 8 or 10. */
CANSER_INLINE uint64_t survey_ahead_by(survey_marks marks, const uint64_t n[4], const int most)
{
    uint64_t at[11];

    for (int by = 0; by <= most; by++)
        at[by] = survey_ahead(marks, by);
    for (int by = 0; by < most; by += 2)
        at[by] = survey_choose(n[0], at[by], at[by + 1]);
    for (int by = 0; by + 2 <= most; by += 4)
        at[by] = survey_choose(n[1], at[by], at[by + 2]);
    return survey_choose(n[3], survey_choose(n[2], at[0], at[4]), at[8]);
}

/* The number of the lowest bit that is set; `bits` is not 0. */
CANSER_INLINE size_t lowest_bit(uint64_t bits)
{
    return (unsigned)__builtin_ctzll(bits);
}

/* The number of the highest one. */
CANSER_INLINE size_t highest_bit(uint64_t bits)
{
    return 63 - (unsigned)__builtin_clzll(bits);
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
