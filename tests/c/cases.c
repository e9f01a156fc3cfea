/* Every short string over the bytes that matter to a protocol, decoded by csrc
 * and by plain.c: the same frames, offsets, ends, control packets and statistics.
 *
 *     cases           all strings
 *     cases LIMIT     at most about LIMIT strings of each set and length, evenly spread
 */
#include "drive.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    LEN_MAX = 44,            /* the longest string of a set: four frames */
    PAD = CANSER_PACKET_MAX, /* bytes behind a string, so that whole windows are there */
    STEPS_FREE = 5,          /* steps of the clock that may be any */
    STEPS_MAX = 17 + STEPS_FREE,
    CLOCK_LEN = 11,                           /* a frame without payload */
    STREAM_MAX = (STEPS_MAX + 1) * CLOCK_LEN, /* more than 2 * LEN_MAX + PAD */
    ROW_CAP = STREAM_MAX / 2 + 2,             /* no frame is shorter than 2 bytes */
    ALL_SPLITS = 60000, /* up to so many strings of a length: every split in two */
    FAILURES_SHOWN = 10
};

/* The strings of a set, written as words. A word is the alternatives of one
 * position, separated by slashes: a byte in hex; `*`, any byte; `sum+N`, N over
 * the low byte of the sum of the 17 bytes before, the check of a fixed packet.
 * `:N` behind a word repeats it. All shorter strings, cut at their end, belong
 * to the set, too. */
typedef struct {
    int protocol;
    int repeat; /* how often the words stand one behind the other */
    const char *words;
} set;

static const set sets[] = {
    /* Any order of headers, fill and commands. */
    {PLAIN_cantalope, 1, "FF/0/1/8/9/F/11:6"},
    {PLAIN_cantalope, 1, "FF/0/1/2/12:8"},
    {PLAIN_cantalope, 1, "FF/0/1/8:8"},
    {PLAIN_cantalope, 1, "FF/0/8:11"},
    {PLAIN_cantalope, 1, "FF/1:14"},
    {PLAIN_cantalope, 1, "FF/0:14"},
    /* All headers, all commands, all lengths. */
    {PLAIN_cantalope, 1, "* * 0/1/FF"},
    {PLAIN_cantalope, 1, "FF FF * * 1"},
    {PLAIN_cantalope, 1, "FF/1F * FF/0 FF/1 0/1/FF 0/FF/8 1 2 3 4 5 6 7/FF"},
    {PLAIN_cantalope, 1, "0/FF 8/18/F 1 2 3 4 5 6 7/FF 8/FF FF/0 FF/8 0/1/2 FF/9 FF 0 FF FF"},

    /* Any order of markers, types and end marks. */
    {PLAIN_seeed, 1, "AA/55/C0/C1/D1/E1/F1/1:6"},
    {PLAIN_seeed, 1, "AA/55/C1/E1/1:8"},
    {PLAIN_seeed, 1, "AA/55/D2/1:9"},
    {PLAIN_seeed, 1, "AA/55/F1/1:9"},
    {PLAIN_seeed, 1, "AA/55/C0:11"},
    /* All types, and the bounds of both ids. */
    {PLAIN_seeed, 1, "AA * 55 * 55/0 55"},
    {PLAIN_seeed, 1, "AA E0/E1/E8/E9/F0/F2 0/FF 55 FF * 55/0/AA 55/C0 0/55 55"},
    {PLAIN_seeed, 1,
     "AA C8/D8/E8/F8 1 1/8 1/55 1F/20/55 55/AA 55/C0 1 1 55 55/AA 55 55/AA 55/0 0/55 55"},
    /* Frames inside a candidate that fails only at its end. */
    {PLAIN_seeed, 1, "AA C8/E8 1/AA 1/C0 AA/1 C1/C0/1 1 1/55 AA/55 55/1 AA/1 C0 AA/1 1/55 0/55 55"},
    /* Fixed packets: every field in and out of range. */
    {PLAIN_seeed, 1,
     "AA 55 0/1/2/4 0/1/2/3 0/1/2/3 0/FF 0/7/8/FF 0/1 0/1F/20 0/8/9 11 22 33 44 55 66 77 88 0/1 "
     "sum+0/sum+1"},
    {PLAIN_seeed, 1, "AA 55 1 1/2 1/2 * 7/8 0 1F/20 8 1 2 3 4 5 6 7 8 0 sum+0"},
    {PLAIN_seeed, 1, "AA 55 1 2 1/2 FF FF/0 FF 1F/20/FF * 1 2 3 AA 55 6 7 8 0 sum+0"},
    {PLAIN_seeed, 1, "AA 55 * 1/2 1 1 0 0 0 8/9 1 2 3 AA 55/C0 6 0/55 55 0/1 sum+0/sum+FF"},
    /* Frames and fixed packets inside a fixed packet whose sum is wrong. */
    {PLAIN_seeed, 1, "AA 55 55/AA:13 0 1 55/AA AA/55/sum+0 AA/55/sum+0"},
    {PLAIN_seeed, 1,
     "AA 55 1/4 AA/1 C1/1 55/1 1 AA/0 55/0 AA/2 C0/55 1 1/AA 55 1 55 AA/1 E0/1 0/AA sum+0/sum+1 "
     "0/AA 0/C0 55 55"},
    {PLAIN_seeed, 1,
     "AA 55 AA/1 55/2 1/4 1 1/0 0 0/AA 1/55 AA/9 C0/22 1 1 55 1 2 0 0 sum+0/sum+1 sum+0/sum+1 "
     "sum+0/sum+1 55/sum+0 AA C0"},
    /* Two of them, one behind the other. */
    {PLAIN_seeed, 2, "AA 55 1/4 1/3 1 23 1 0 0 2/9 AA/11 C0/22 0 0 55 0:3 0/1 sum+0/sum+1"},

    /* Any order of marks, lengths and flags behind a marker. */
    {PLAIN_serial, 1, "AA AA/BB/0/1:10"},
    {PLAIN_serial, 1, "AA AA/BB/0:11"},
    {PLAIN_serial, 1, "AA AA/BB/1:11"},
    {PLAIN_serial, 1, "AA AA/BB/1:8 40/C0/1/AA BB/AA/1 BB/AA/1"},
    {PLAIN_serial, 10, "AA/BB/0 0"},
    {PLAIN_serial, 8, "AA/0 AA/BB 0"},
    {PLAIN_serial, 2, "AA/BB AA 0:3 0/AA/1 0/AA AA 0 0 BB/AA BB/0"},
    /* All lengths and all flags, each with the end mark at its place and not. */
    {PLAIN_serial, 1, "AA 0 0 AA FF * 0/FF 7/8 0 0/20/40/60/80/A0/C0/E0/FF BB/0/AA BB"},
    {PLAIN_serial, 1, "AA 0:4 0/1 0/AA/FF 7/8 0 * BB/0/AA BB"},
    {PLAIN_serial, 1,
     "AA 1 2 3 4 0/1/2/7/8/9 1 0 0 0/1F/20/40/60/80/C0/E0 BB/AA BB/0 BB/1 0:4 BB/0:3"},
    /* Frames inside a candidate that fails only at its end. */
    {PLAIN_serial, 1,
     "AA AA/1 2 3/AA 4 8/1/AA AA/0 0/8 AA/0 40/0/AA AA/BB/0 BB/0 BB/0 AA/0 0/BB BB 0 BB BB/0 BB 0 "
     "BB"},
    /* The clock: small and large steps, forward, back, and through zero. */
    {PLAIN_serial, 3, "AA 0/1/FF 0 0 0/7F/80/FF 0 23 1 0 0 BB"},
    {PLAIN_serial, 4, "AA 0/FF FF FF 0/7F/80 0 23 1 0 0 BB/0"},
};

typedef struct {
    uint8_t value;
    bool is_sum; /* the value is added to the sum of the 17 bytes before */
} choice;

/* What can stand at one position of a set. */
typedef struct {
    choice choices[256];
    unsigned count;
} position;

/* The arrays of one decoding. */
typedef struct {
    canser_frame frames[ROW_CAP];
    int64_t offsets[ROW_CAP];
    int64_t ends[ROW_CAP];
    canser_control controls[ROW_CAP];
} rows;

static drive driven;
static plain_stream open_stream;  /* the bytes, and more may come */
static plain_stream ended_stream; /* the bytes, and nothing behind them */
static unsigned failures_shown;

static void set_up(void)
{
    static rows driven_rows, open_rows, ended_rows;

    driven = (drive){.frames = driven_rows.frames,
                     .offsets = driven_rows.offsets,
                     .ends = driven_rows.ends,
                     .controls = driven_rows.controls,
                     .row_cap = ROW_CAP};
    open_stream = (plain_stream){.frames = open_rows.frames,
                                 .offsets = open_rows.offsets,
                                 .ends = open_rows.ends,
                                 .controls = open_rows.controls,
                                 .row_cap = ROW_CAP};
    ended_stream = (plain_stream){.frames = ended_rows.frames,
                                  .offsets = ended_rows.offsets,
                                  .ends = ended_rows.ends,
                                  .controls = ended_rows.controls,
                                  .row_cap = ROW_CAP};
}

static bool report(const char *what, int protocol, const char *how, size_t at, const uint8_t *bytes,
                   size_t len)
{
    if (!what)
        return true;
    if (failures_shown++ < FAILURES_SHOWN) {
        printf("FAILED %s, %s %zu: %s:", plain_format_of(protocol)->name, how, at, what);
        for (size_t i = 0; i < len; i++)
            printf(" %02X", bytes[i]);
        printf("\n");
    }
    return false;
}

/* A unit of time that no other quantity here resembles. */
static const int64_t TICK = 1000;

static void scan_both(int protocol, const uint8_t *bytes, size_t len)
{
    plain_begin(&open_stream, protocol, TICK);
    plain_scan(&open_stream, bytes, len, false);
    plain_begin(&ended_stream, protocol, TICK);
    plain_scan(&ended_stream, bytes, len, true);
}

/* Decode in pieces of `piece` bytes, the first one of `first`; compare before
 * the end of the stream and after it. */
static bool check_pieces(int protocol, const uint8_t *bytes, size_t len, size_t first, size_t piece,
                         size_t cap, const char *how, size_t at)
{
    size_t pos = first;

    drive_begin(&driven, protocol, TICK);
    drive_feed(&driven, bytes, first, cap, cap);
    while (pos < len) {
        const size_t next = len - pos < piece ? len - pos : piece;
        drive_feed(&driven, bytes + pos, next, cap, cap);
        pos += next;
    }
    const char *what = drive_compare(&driven, &open_stream);
    if (!what) {
        drive_flush(&driven, cap, cap);
        what = drive_compare(&driven, &ended_stream);
    }
    return report(what, protocol, how, at, bytes, len);
}

/* The string twice with the end of the stream between: the counters go on. */
static bool check_again(int protocol, const uint8_t *bytes, size_t len)
{
    plain_scan(&ended_stream, bytes, len, true);
    drive_begin(&driven, protocol, TICK);
    for (int i = 0; i < 2; i++) {
        drive_feed(&driven, bytes, len, SIZE_MAX, SIZE_MAX);
        drive_flush(&driven, SIZE_MAX, SIZE_MAX);
    }
    return report(drive_compare(&driven, &ended_stream), protocol, "ended and fed again", 2, bytes,
                  len);
}

/* The string twice and a padding of zeros, so that most of it is scanned where
 * whole windows are there; half of the strings without ends, which has a loop of its own. */
static bool check_padded(int protocol, const uint8_t *bytes, size_t len, uint64_t index)
{
    uint8_t stream[STREAM_MAX] = {0};
    const size_t stream_len = 2 * len + PAD;

    memcpy(stream, bytes, len);
    memcpy(stream + len, bytes, len);
    scan_both(protocol, stream, stream_len);
    driven.no_ends = index * 0x9E3779B97F4A7C15 >> 63;
    const bool good =
        check_pieces(protocol, stream, stream_len, stream_len, 1, SIZE_MAX, "padded", 0);
    driven.no_ends = false;
    return good;
}

static bool check_string(int protocol, const uint8_t *bytes, size_t len, bool all_splits,
                         uint64_t index)
{
    scan_both(protocol, bytes, len);
    bool good = check_pieces(protocol, bytes, len, len, 1, SIZE_MAX, "whole", 0);
    /* Arrays of 1, 2 or 3 rows, that may be full while bytes are held. */
    if (all_splits) {
        for (size_t at = 1; at < len; at++)
            good &= check_pieces(protocol, bytes, len, at, len, 1 + at % 3, "split at", at);
    } else if (len > 1) {
        /* One split, spread over the strings without a period in common with
         * the order in which they come. */
        const size_t at = 1 + (size_t)((index * 0x9E3779B97F4A7C15 >> 32) % (len - 1));
        good &= check_pieces(protocol, bytes, len, at, len, 1 + at % 3, "split at", at);
    }
    good &= check_pieces(protocol, bytes, len, 1, 1, SIZE_MAX, "pieces of", 1);
    good &= check_pieces(protocol, bytes, len, len, 1, 1, "capacity", 1);
    good &= check_again(protocol, bytes, len);
    good &= check_padded(protocol, bytes, len, index);
    return good;
}

static position parse_word(const char *word)
{
    position p = {.count = 0};

    if (*word == '*') {
        for (unsigned i = 0; i < 256; i++)
            p.choices[p.count++] = (choice){(uint8_t)i, false};
        return p;
    }
    for (;;) {
        char *rest;
        const bool is_sum = strncmp(word, "sum+", 4) == 0;
        const unsigned long value = strtoul(is_sum ? word + 4 : word, &rest, 16);
        p.choices[p.count++] = (choice){(uint8_t)value, is_sum};
        if (*rest != '/')
            return p;
        word = rest + 1;
    }
}

/* Returns the number of positions. */
static size_t parse_set(const set *s, position positions[LEN_MAX])
{
    size_t len = 0;

    for (int i = 0; i < s->repeat; i++) {
        for (const char *word = s->words; *word; word += *word == ' ') {
            const position p = parse_word(word);
            unsigned long times = 1;

            word += strcspn(word, " :");
            if (*word == ':')
                times = strtoul(word + 1, NULL, 10);
            word += strcspn(word, " ");
            for (unsigned long k = 0; k < times; k++) {
                if (len == LEN_MAX)
                    abort();
                positions[len++] = p;
            }
        }
    }
    return len;
}

/* The string that the digits choose. */
static void compose(const position *positions, const unsigned *digits, size_t len, uint8_t *bytes)
{
    for (size_t i = 0; i < len; i++) {
        const choice chosen = positions[i].choices[digits[i]];
        unsigned value = chosen.value;

        for (size_t k = i < 17 ? 0 : i - 17; chosen.is_sum && k < i; k++)
            value += bytes[k];
        bytes[i] = (uint8_t)value;
    }
}

/* Every `stride`-th string of a length. The stride has no factor in common with
 * the number of choices at a position, so that every choice comes up. */
static uint64_t choose_stride(const position *positions, size_t len, uint64_t total, uint64_t limit)
{
    uint64_t stride = total / limit + 1;
    size_t i = 0;

    while (stride > 1 && i < len) {
        uint64_t a = positions[i].count, b = stride;
        while (b) {
            const uint64_t rest = a % b;
            a = b;
            b = rest;
        }
        if (a > 1) {
            stride++;
            i = 0;
        } else {
            i++;
        }
    }
    return stride;
}

/* Frames whose counter starts at `raw` and makes these steps. */
static bool check_steps(uint32_t raw, const uint32_t *steps, size_t step_count)
{
    uint8_t stream[STREAM_MAX];
    size_t len = 0;

    for (size_t i = 0; i <= step_count; i++) {
        uint8_t *const frame = stream + len;
        memset(frame, 0, CLOCK_LEN);
        frame[0] = 0xAA;
        for (int k = 0; k < 4; k++)
            frame[1 + k] = (uint8_t)(raw >> 8 * k);
        frame[CLOCK_LEN - 1] = 0xBB;
        len += CLOCK_LEN;
        raw += i < step_count ? steps[i] : 0;
    }
    scan_both(PLAIN_serial, stream, len);
    bool good = check_pieces(PLAIN_serial, stream, len, len, 1, SIZE_MAX, "clock", step_count);
    good &= check_pieces(PLAIN_serial, stream, len, 13, 13, SIZE_MAX, "clock, pieces of", 13);
    good &= check_pieces(PLAIN_serial, stream, len, len, 1, 1, "clock, capacity", 1);
    return good;
}

/* The clock of `serial` remembers more than one step: what a large one means
 * depends on whether the clock ran in line before. So, behind few or enough
 * small steps, all orders of steps at the bounds: the largest that is small,
 * half a turn, a third of a turn, and what leads from half a turn back to where
 * the clock stood, just near enough and not. */
static void run_clock(uint64_t limit, uint64_t *string_count, uint64_t *failed)
{
    static const uint32_t kinds[] = {1,          0x1000000,  0x1000001,  0x55555555, 0x7EFFFFFF,
                                     0x7F000000, 0x80000000, 0x81000000, 0x81000001};
    static const size_t small_counts[] = {0, 15, 16, STEPS_MAX - STEPS_FREE};
    enum { KINDS = sizeof kinds / sizeof *kinds };
    uint64_t total = 1, stride;

    for (int i = 0; i < STEPS_FREE; i++)
        total *= KINDS;
    stride = total / limit + 1;
    stride += stride % 3 == 0; /* no factor in common with KINDS */

    for (size_t n = 0; n < sizeof small_counts / sizeof *small_counts; n++) {
        const size_t small_count = small_counts[n];
        for (uint64_t order = 0; order < total; order += stride) {
            uint32_t steps[STEPS_MAX];
            uint64_t rest = order;

            for (size_t i = 0; i < small_count; i++)
                steps[i] = 1;
            for (size_t i = 0; i < STEPS_FREE; i++) {
                steps[small_count + i] = kinds[rest % KINDS];
                rest /= KINDS;
            }
            /* Far from a wrap, and one tick before it. */
            *string_count += 2;
            *failed += !check_steps(0x12345678, steps, small_count + STEPS_FREE);
            *failed +=
                !check_steps(UINT32_MAX - (uint32_t)small_count, steps, small_count + STEPS_FREE);
        }
    }
}

static void run_set(const set *s, uint64_t limit, uint64_t *string_count, uint64_t *failed)
{
    position positions[LEN_MAX];
    const size_t len_max = parse_set(s, positions);
    uint64_t total = 1;

    for (size_t len = 1; len <= len_max; len++) {
        unsigned digits[LEN_MAX] = {0};
        total *= positions[len - 1].count;
        const uint64_t stride = choose_stride(positions, len, total, limit);

        for (uint64_t index = 0; index < total; index += stride) {
            uint8_t bytes[LEN_MAX];
            compose(positions, digits, len, bytes);
            ++*string_count;
            *failed += !check_string(s->protocol, bytes, len, total <= ALL_SPLITS, index);

            uint64_t carry = stride;
            for (size_t i = 0; i < len && carry; i++) {
                carry += digits[i];
                digits[i] = (unsigned)(carry % positions[i].count);
                carry /= positions[i].count;
            }
        }
    }
}

int main(int argc, char **argv)
{
    const uint64_t limit = argc > 1 ? strtoull(argv[1], NULL, 10) : UINT64_MAX;
    uint64_t passed = 0, failed = 0;

    if (!limit) {
        fprintf(stderr, "usage: cases [LIMIT], the strings of each set and length, at least 1\n");
        return 2;
    }
    set_up();
    for (int protocol = 0; protocol < PLAIN_PROTOCOL_COUNT; protocol++) {
        uint64_t string_count = 0, bad = 0;
        for (size_t i = 0; i < sizeof sets / sizeof *sets; i++) {
            if (sets[i].protocol == protocol)
                run_set(&sets[i], limit, &string_count, &bad);
        }
        if (protocol == PLAIN_serial)
            run_clock(limit, &string_count, &bad);
        printf("%s: %llu strings\n", plain_format_of(protocol)->name,
               (unsigned long long)string_count);
        if (!string_count) {
            printf("FAILED there is no set of strings for %s\n", plain_format_of(protocol)->name);
            failed++;
        }
        passed += string_count - bad;
        failed += bad;
    }
    printf("%llu passed, %llu failed\n", (unsigned long long)passed, (unsigned long long)failed);
    return failed > 0;
}
