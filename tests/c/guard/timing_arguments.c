/* The caller's mistakes in a call of canser_timing_assign(). */
#include "arena.h"
#include "checks.h"
#include "tests.h"

#include <math.h>
#include <string.h>

void test_times_arguments(void)
{
    const canser_piece pieces[2] = {{0, 0}, {9, 9}};
    const canser_piece *const pieces_off = behind((void *)(uintptr_t)pieces, 1);
    const int64_t at[4] = {5, 6, 7, 8};
    const int64_t *const at_off = (const int64_t *)(const void *)((const uint8_t *)at + 1);
    canser_frame memory[4];
    canser_sample samples[2];
    canser_timing good = {.tick_ns = 1, .samples = samples, .sample_cap = 2};
    canser_timing setups[11];
    size_t done = 1;

    begin_part("times: arguments");
    memset(memory, UNUSED_BYTE, sizeof memory);
    memset(samples, UNUSED_BYTE, sizeof samples);
    for (size_t i = 0; i < sizeof setups / sizeof *setups; i++)
        setups[i] = good;
    setups[0].samples = NULL;
    setups[1].samples = behind(samples, 1);
    setups[2].tick_ns = -1;
    setups[3].tick_ns = INT64_C(1) << 31;
    setups[4].byte_ns = -1;
    setups[5].byte_ns = NAN;
    setups[6].byte_ns = 2e9 + 1;
    setups[7].line.drift = 1;
    setups[8].line.drift = NAN;
    setups[9].trust.early = -1;
    setups[10].trust.late = -1;
    const struct {
        const char *what;
        canser_timing *self;
        const canser_piece *pieces;
        size_t piece_count;
        const int64_t *at;
        canser_frame *frames;
        size_t count;
        size_t *done;
        int expected;
    } calls[] = {
        {"self NULL", NULL, pieces, 2, at, memory, 4, &done, CANSER_NULL},
        {"pieces NULL", &good, NULL, 2, at, memory, 4, &done, CANSER_NULL},
        {"no pieces", &good, pieces, 0, at, memory, 4, &done, CANSER_NULL},
        {"offsets NULL", &good, pieces, 2, NULL, memory, 4, &done, CANSER_NULL},
        {"frames NULL", &good, pieces, 2, at, NULL, 4, &done, CANSER_NULL},
        {"done NULL", &good, pieces, 2, at, memory, 4, NULL, CANSER_NULL},
        {"no frames", &good, pieces, 2, NULL, NULL, 1, &done, CANSER_OK},
        {"pieces", &good, pieces_off, 1, at, memory, 4, &done, CANSER_MISALIGNED},
        {"offsets", &good, pieces, 2, at_off, memory, 3, &done, CANSER_MISALIGNED},
        {"frames", &good, pieces, 2, at, behind(memory, 1), 3, &done, CANSER_MISALIGNED},
        {"samples NULL", &setups[0], pieces, 2, at, memory, 4, &done, CANSER_NULL},
        {"samples", &setups[1], pieces, 2, at, memory, 4, &done, CANSER_MISALIGNED},
        {"tick", &setups[2], pieces, 2, at, memory, 4, &done, CANSER_TICK},
        {"tick", &setups[3], pieces, 2, at, memory, 4, &done, CANSER_TICK},
        {"byte_ns", &setups[4], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"byte_ns", &setups[5], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"byte_ns", &setups[6], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"drift", &setups[7], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"drift", &setups[8], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"early", &setups[9], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
        {"late", &setups[10], pieces, 2, at, memory, 4, &done, CANSER_RANGE},
    };
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        now.part = calls[i].what;
        check(canser_timing_assign(calls[i].self, calls[i].pieces, calls[i].piece_count,
                                   calls[i].at, calls[i].frames, calls[i].count,
                                   calls[i].done) == calls[i].expected,
              "another status");
    }
    now.part = "times: what is left";
    check(done == 1 && is_filled(memory, sizeof memory, UNUSED_BYTE) &&
              is_filled(samples, sizeof samples, UNUSED_BYTE),
          "something was written");
}
