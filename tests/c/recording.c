/* What canser.h promises of canser_recording_gather(): blocks that nothing is unusual about are
 * taken, all others are not, and no memory but the caller's is touched. Every array lies against
 * a page that may not be touched. POSIX only. */
#include "guarded.h"

#include "canser.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    LINE_MAX = 9000, /* bytes in a block: more than are folded at a time */
    BLOCK_MAX = LINE_MAX + 80,
    BLOCKS_MAX = 8,
    FILE_MAX = BLOCKS_MAX * BLOCK_MAX
};

static unsigned long long passed, failed;

static void check(bool holds, const char *what, size_t round)
{
    if (holds)
        passed++;
    else if (failed++ < 10)
        printf("FAILED %s, round %zu\n", what, round);
}

/* The CRC32 bit by bit, as its definition has it. */
static uint32_t slow_crc32(const uint8_t *p, size_t len)
{
    uint32_t crc = UINT32_MAX;

    for (size_t i = 0; i < len; i++) {
        crc ^= p[i];
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

static size_t put(uint8_t *p, uint64_t value, size_t size)
{
    for (size_t i = 0; i < size; i++)
        p[i] = (uint8_t)(value >> 8 * i);
    return size;
}

/* What may be unusual about a block. */
enum {
    USUAL,
    NO_BYTES,
    OTHER_TYPE,
    OTHER_LENGTH,
    OTHER_END,
    OTHER_INTERFACE,
    LATE,
    LONGER_LINE,
    OTHER_HASH,
    OTHER_ALGORITHM,
    OTHER_CRC32,
    OTHER_BYTE,
    OTHER_NUMBER,
    OTHER_OPTION,
    COMMENT,
    CUT,
    KIND_COUNT
};

/* Write a block; return its length. */
static size_t put_block(uint8_t *block, int kind, uint32_t interface, bool has_id, uint64_t id,
                        int64_t ns, const uint8_t *line, size_t len)
{
    const size_t padded = (len + 3) / 4 * 4, total = 60 + padded + (kind == COMMENT ? 8 : 0);
    const uint32_t flip = 1u << random_below(20);
    uint8_t *p = block;

    p += put(p, kind == OTHER_TYPE ? 5 : 6, 4);
    p += put(p, total + (kind == OTHER_LENGTH ? 4 : 0), 4);
    p += put(p, interface + (kind == OTHER_INTERFACE), 4);
    p += put(p, (uint64_t)ns >> 32 | (kind == LATE ? 1u << 31 : 0), 4);
    p += put(p, (uint64_t)ns & UINT32_MAX, 4);
    p += put(p, kind == LONGER_LINE ? UINT32_MAX - random_below(99) : len, 4);
    p += put(p, len, 4);
    memcpy(p, line, len);
    memset(p + len, 0, padded - len);
    if (kind == OTHER_BYTE)
        p[random_below(len)] ^= (uint8_t)(1 << random_below(8));
    p += padded;
    p += put(p, kind == OTHER_HASH ? 2 : 3, 2);
    p += put(p, 5, 2);
    *p++ = kind == OTHER_ALGORITHM ? 3 : 2;
    p += put(p, slow_crc32(line, len) ^ (kind == OTHER_CRC32 ? flip : 0), 4);
    p += put(p, 0, 3);
    p += put(p, (has_id ? 5u : 4u) + (kind == OTHER_OPTION), 2);
    p += put(p, 8, 2);
    p += put(p, (has_id ? id : 0) ^ (kind == OTHER_NUMBER ? (uint64_t)flip << 40 : 0), 8);
    if (kind == COMMENT) {
        p += put(p, 1, 2);
        p += put(p, 4, 2);
        p += put(p, 0x65746F6E, 4);
    }
    p += put(p, 0, 4);
    p += put(p, total + (kind == OTHER_END ? 4 : 0), 4);
    return (size_t)(p - block);
}

static void random_line(uint8_t *line, size_t len)
{
    for (size_t i = 0; i < len; i++)
        line[i] = (uint8_t)(random_word() >> 40);
}

/* Blocks of which one may be unusual, with any room for what they hold. */
static void check_round(size_t round, uint8_t *file_end, uint8_t *out_end, uint8_t *pieces_end)
{
    static uint8_t file[FILE_MAX], want[BLOCKS_MAX * LINE_MAX];
    static canser_recording self;
    canser_piece ends[BLOCKS_MAX];
    const size_t blocks = random_below(BLOCKS_MAX + 1), odd = random_below(BLOCKS_MAX + 1);
    const int kind = round % 4 ? (int)(round / 4 % KIND_COUNT) : USUAL;
    const uint32_t interface = (uint32_t)random_below(3);
    const bool has_ids = random_below(3);
    const uint64_t first_id = random_below(2) ? random_word() : UINT64_MAX - random_below(300);
    size_t file_len = 0, want_len = 0, good = 0, used = 0;

    const size_t out_cap = random_below(3) ? BLOCKS_MAX * LINE_MAX : random_below(4 * LINE_MAX);
    const size_t piece_cap = random_below(3) ? BLOCKS_MAX : random_below(BLOCKS_MAX);
    bool stopped = false;
    for (size_t i = 0; i < blocks; i++) {
        const int this_kind = i == odd ? kind : USUAL;
        const size_t longest = random_below(3) ? 200 : LINE_MAX;
        const size_t len = this_kind == NO_BYTES ? 0 : 1 + random_below(longest);
        const int64_t ns = (int64_t)(random_word() >> 1);
        uint8_t line[LINE_MAX];

        random_line(line, len);
        size_t total = put_block(file + file_len, this_kind, interface, has_ids,
                                 first_id + want_len, ns, line, len);
        if (this_kind == CUT)
            total = random_below(total);
        file_len += total;
        stopped |= this_kind != USUAL || len > out_cap - want_len || good == piece_cap;
        if (!stopped) {
            memcpy(want + want_len, line, len);
            want_len += len;
            ends[good++] = (canser_piece){(int64_t)want_len, ns};
            used = file_len;
        }
        if (this_kind == CUT)
            break;
    }

    uint8_t *const data = file_end - file_len, *const out = out_end - out_cap;
    canser_piece *const pieces = (canser_piece *)(void *)(pieces_end - piece_cap * sizeof *pieces);
    canser_gathered got = {9, 9, 9};
    if (file_len)
        memcpy(data, file, file_len);
    canser_recording_init(&self);
    self.interface = interface;
    self.has_ids = has_ids;
    self.next_id = first_id;
    check(canser_recording_gather(&self, data, file_len, out, out_cap, pieces, piece_cap, &got) ==
              CANSER_OK,
          "the status", round);
    check(got.used == used && got.byte_count == want_len && got.piece_count == good, "the counts",
          round);
    check(memcmp(out, want, got.byte_count) == 0, "the bytes", round);
    check(memcmp(pieces, ends, got.piece_count * sizeof *ends) == 0, "the pieces", round);
    check(self.next_id == first_id + want_len, "the next id", round);
}

/* A block of every length. */
static void check_lengths(uint8_t *file_end, uint8_t *out_end)
{
    static canser_recording self;
    static uint8_t line[LINE_MAX], block[BLOCK_MAX];

    canser_recording_init(&self);
    random_line(line, LINE_MAX);
    for (size_t len = 1; len <= LINE_MAX; len += len < 1500 ? 1 : 1 + random_below(99)) {
        const size_t total = put_block(block, USUAL, 0, true, self.next_id, 7, line, len);
        canser_gathered got;
        canser_piece piece;

        self.has_ids = 1;
        memcpy(file_end - total, block, total);
        canser_recording_gather(&self, file_end - total, total, out_end - len, len, &piece, 1,
                                &got);
        check(got.used == total && got.byte_count == len && got.piece_count == 1 &&
                  piece.end == (int64_t)len && piece.ns == 7 &&
                  memcmp(out_end - len, line, len) == 0,
              "a length", len);
    }
}

static void check_arguments(void)
{
    static canser_recording self;
    static uint8_t block[100], out[100];
    canser_piece pieces[3];
    const uint8_t line[] = {1, 2, 3, 4, 5};
    const size_t total = put_block(block, USUAL, 0, false, 0, 1, line, sizeof line);
    canser_piece *const off = (canser_piece *)(void *)((uint8_t *)pieces + 1);
    canser_gathered got;

    check(canser_recording_init(NULL) == CANSER_NULL, "init of NULL", 0);
    check(canser_recording_init(&self) == CANSER_OK, "init", 0);
    const struct {
        canser_recording *self;
        uint8_t *data, *out;
        canser_piece *pieces;
        int expected;
    } calls[] = {{NULL, block, out, pieces, CANSER_NULL},
                 {&self, NULL, out, pieces, CANSER_NULL},
                 {&self, block, NULL, pieces, CANSER_NULL},
                 {&self, block, out, NULL, CANSER_NULL},
                 {&self, block, out, off, CANSER_MISALIGNED},
                 {&self, block, block + 10, pieces, CANSER_OVERLAP},
                 {&self, block, (uint8_t *)pieces, pieces, CANSER_OVERLAP},
                 {&self, (uint8_t *)pieces, out, pieces, CANSER_OVERLAP}};
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        got = (canser_gathered){9, 9, 9};
        check(canser_recording_gather(calls[i].self, calls[i].data, total, calls[i].out, 8,
                                      calls[i].pieces, 2, &got) == calls[i].expected,
              "another status", i);
        check(!got.used && !got.byte_count && !got.piece_count, "the result is not set", i);
    }
    check(canser_recording_gather(&self, block, total, out, 8, pieces, 2, NULL) == CANSER_NULL,
          "no result", 0);
    check(canser_recording_gather(&self, NULL, 0, NULL, 0, NULL, 0, &got) == CANSER_OK, "no arrays",
          0);
    check(canser_recording_gather(&self, block, total, out, 8, pieces, 2, &got) == CANSER_OK &&
              got.used == total && got.byte_count == 5 && got.piece_count == 1,
          "a good call", 0);
}

int main(void)
{
    uint8_t *const file_end = guarded(FILE_MAX), *const out_end = guarded(BLOCKS_MAX * LINE_MAX);
    uint8_t *const pieces_end = guarded(BLOCKS_MAX * sizeof(canser_piece));

    for (size_t round = 0; round < 4000; round++)
        check_round(round, file_end, out_end, pieces_end);
    check_lengths(file_end, out_end);
    check_arguments();
    printf("%llu passed, %llu failed\n", passed, failed);
    return failed != 0;
}
