/* More than 4 GiB in one call. */
#define _DEFAULT_SOURCE /* MAP_ANONYMOUS, where -std=c11 hides it */
#define _DARWIN_C_SOURCE

#include "checks.h"
#include "plain.h"
#include "tests.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

/* The chunk that is mapped again and again, and how often: over 4 GiB. */
enum { CHUNK = 1 << 26, CHUNK_COUNT = 66 };

/* A region of zeros that takes the memory of a few chunks: one file's pages,
 * over and over, and private ones where frames are to be written. */
static uint8_t *map_huge(void)
{
    FILE *const file = tmpfile();
    uint8_t *const region =
        mmap(NULL, (size_t)CHUNK * CHUNK_COUNT, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);

    if (!file || ftruncate(fileno(file), CHUNK) || region == MAP_FAILED)
        return NULL;
    for (size_t i = 0; i < CHUNK_COUNT; i++) {
        /* Frames lie around 2 GiB, around 4 GiB and at the end. */
        const bool is_private = i == 31 || i == 32 || i >= 63;
        if (mmap(region + i * CHUNK, CHUNK, is_private ? PROT_READ | PROT_WRITE : PROT_READ,
                 (is_private ? MAP_PRIVATE : MAP_SHARED) | MAP_FIXED, fileno(file),
                 0) == MAP_FAILED)
            return NULL;
    }
    return region;
}

/* More than 4 GiB in one call: every length and every offset is a size_t or 64
 * bits wide all the way. One protocol will do: the loops that count are one
 * source for all, and zeros are noise to this one. */
void test_huge(void)
{
    const uint64_t size = (uint64_t)CHUNK * CHUNK_COUNT;
    const uint64_t places[] = {
        (UINT64_C(1) << 31) - 3, /* across 2 GiB */
        (UINT64_C(1) << 32) - 4, /* across 4 GiB */
        (UINT64_C(1) << 32) + 100,
        size - 60,
    };
    enum { PLACES = sizeof places / sizeof *places };
    const canser_frame sent = {.id = 0x123, .dlc = 8, .data = {1, 2, 3, 4, 5, 6, 7, 8}};
    uint8_t packet[CANSER_PACKET_MAX];
    canser_frame frames[PLACES + 1];
    int64_t offsets[PLACES + 1], ends[PLACES + 1];
    canser_batch batch = {
        .frames = frames, .frame_cap = PLACES + 1, .offsets = offsets, .ends = ends};
    canser_decoder decoder;
    size_t used = 0;
    int refusal;

    uint8_t *const region = map_huge();
    if (!region) {
        perror("guard: mmap");
        exit(2);
    }
    begin_part("huge");
    now.protocol = PLAIN_serial;
    const size_t len = plain_encode(PLAIN_serial, 1000, &sent, packet, &refusal);
    for (size_t i = 0; i < PLACES; i++)
        memcpy(region + places[i], packet, len);
    /* The last bytes are the first ones of one more frame. */
    memcpy(region + size - 7, packet, 7);

    canser_decoder_init(&decoder, canser_protocol_at(PLAIN_serial), 1000);
    check(canser_decoder_feed(&decoder, region, (size_t)size, &batch, &used) == CANSER_OK,
          "status");
    check(used == size, "not all is taken");
    check(batch.frame_count == PLACES, "the number of frames differs");
    for (size_t i = 0; i < PLACES && i < batch.frame_count; i++) {
        check((uint64_t)offsets[i] == places[i], "an offset differs");
        check((uint64_t)ends[i] == places[i] + len, "an end differs");
        check(memcmp(&frames[i], &sent, sizeof sent) == 0, "a frame differs");
    }
    check(decoder.carry_len == 7, "the start of a frame is not held");
    check(decoder.stats.bytes_in == size, "bytes_in differs");
    check(decoder.stats.bytes_framed == PLACES * len, "bytes_framed differs");
    check(decoder.stats.bytes_skipped == size - PLACES * len - 7, "bytes_skipped differs");
    check(decoder.stats.rejects[CANSER_REJECT_MARKER] == decoder.stats.bytes_skipped,
          "the rejects differ");
    check(decoder.stats.resyncs == PLACES + 1, "resyncs differs");

    /* The stream goes on, and offsets are still those of the whole stream. */
    check(canser_decoder_feed(&decoder, packet + 7, len - 7, &batch, &used) == CANSER_OK, "status");
    check(batch.frame_count == 1 && (uint64_t)offsets[0] == size - 7 &&
              (uint64_t)ends[0] == size - 7 + len,
          "the offset or the end of a frame across two calls differs");
}
