/* What canser.h promises of captures: what is written reads back, in both byte orders and wherever
 * it is cut; damaged packets are never more than left to the caller; and no memory but the caller's
 * is touched. Every array lies against a page that may not be touched. POSIX only. */
#include "guarded.h"

#include "canser.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_MAX = 40, BYTES_MAX = FRAMES_MAX * CANSER_CAPTURED_MAX, INTERFACES = 3 };

/* What a capture is made of: records or blocks, with a direction or without. */
typedef enum { RECORDS, BLOCKS, TAGGED_BLOCKS, KINDS } kind;

static const char *const names[] = {"records", "blocks", "blocks with directions"};

static unsigned long long passed, failed;

static void check(bool holds, const char *what, kind of, size_t round)
{
    if (holds)
        passed++;
    else if (failed++ < 10)
        printf("FAILED %s of %s, round %zu\n", what, names[of], round);
}

static uint8_t *bytes_end, *out_end, *channels_end, *directions_end;
static canser_frame *frames_end;
static canser_interface *interfaces;

static canser_frame random_frame(void)
{
    canser_frame frame = {0};

    frame.ext = (uint8_t)random_below(2);
    frame.id = (uint32_t)random_below(frame.ext ? 0x20000000 : 0x800);
    frame.rtr = (uint8_t)!random_below(4);
    frame.err = (uint8_t)!random_below(4);
    frame.dlc = (uint8_t)random_below(9);
    for (size_t i = 0; !frame.rtr && i < frame.dlc; i++)
        frame.data[i] = (uint8_t)random_below(256);
    frame.ts = (int64_t)random_below((size_t)UINT32_MAX * 1000000000);
    return frame;
}

static canser_capture new_capture(kind of, bool is_big)
{
    canser_capture capture = {.interfaces = interfaces,
                              .interface_count = INTERFACES,
                              .is_blocks = of != RECORDS,
                              .is_big = is_big};
    for (unsigned i = 0; i < INTERFACES; i++)
        capture.numbers[i] = (uint8_t)i;
    return capture;
}

/* Reverse a number of two or four bytes. */
static void reverse(uint8_t *p, size_t len)
{
    for (size_t i = 0; i < len / 2; i++) {
        const uint8_t byte = p[i];
        p[i] = p[len - 1 - i];
        p[len - 1 - i] = byte;
    }
}

/* Cut the bytes behind the data off the packets of records, as some programs do. Return the length.
 */
static size_t shorten(uint8_t *data, size_t len)
{
    uint8_t *to = data;

    for (const uint8_t *p = data; p < data + len; p += 32) {
        const uint8_t size = (uint8_t)(8 + (p[16] & 0x40 ? 0 : p[20]));
        memmove(to, p, 16 + size);
        to[8] = size;
        to += 16 + size;
    }
    return (size_t)(to - data);
}

/* Turn all numbers of a capture that was written, but for those in frames. */
static void turn(kind of, uint8_t *data, size_t len)
{
    const size_t head = of == RECORDS ? 16 : 28;

    for (uint8_t *p = data; p < data + len;) {
        const size_t total = of == RECORDS ? (size_t)16 + p[8] : p[4];
        for (size_t i = 0; i < head; i += 4)
            reverse(p + i, 4);
        if (of == TAGGED_BLOCKS) {
            reverse(p + 44, 2);
            reverse(p + 46, 2);
            reverse(p + 48, 4);
        }
        if (of != RECORDS)
            reverse(p + total - 4, 4);
        p += total;
    }
}

/* Read a capture in pieces, cut at random; end where it is unusual. Return the frames. */
static size_t read_packets(canser_capture *capture, const uint8_t *data, size_t len,
                           canser_frame *frames, uint8_t *channels, uint8_t *directions,
                           size_t *left)
{
    size_t count = 0, used = 0, avail = 0;

    for (bool last = false; !last;) {
        const size_t cap = random_below(6), room = FRAMES_MAX - count;
        canser_rows rows = {.frame_cap = cap < room ? cap : room};
        rows.frames = frames_end - rows.frame_cap;
        rows.channels = channels_end - rows.frame_cap;
        rows.directions = directions_end - rows.frame_cap;
        avail += random_below(2) ? len - avail : random_below(len - avail + 1);
        /* The bytes lie at the end of their pages, so that reading on is a crash. */
        uint8_t *const at = out_end - (avail - used);
        memcpy(at, data + used, avail - used);
        if (canser_capture_read(capture, at, avail - used, &rows) || rows.used > avail - used ||
            rows.frame_count > rows.frame_cap || rows.frame_count > rows.line_count)
            return FRAMES_MAX + 1;
        memcpy(frames + count, rows.frames, rows.frame_count * sizeof *frames);
        memcpy(channels + count, rows.channels, rows.frame_count);
        memcpy(directions + count, rows.directions, rows.frame_count);
        count += rows.frame_count;
        used += rows.used;
        last = rows.is_unusual || count == FRAMES_MAX || used == len ||
               (avail == len && rows.frame_count < rows.frame_cap);
    }
    *left = len - used;
    return count;
}

static void there_and_back(kind of, bool is_big, size_t round)
{
    canser_frame frames[FRAMES_MAX], got[FRAMES_MAX];
    uint8_t channels[FRAMES_MAX], directions[FRAMES_MAX], got_channels[FRAMES_MAX],
        got_directions[FRAMES_MAX];
    const size_t count = 1 + random_below(FRAMES_MAX - 1);
    canser_capture capture = new_capture(of, false);
    canser_encoded result;
    size_t left;

    for (size_t i = 0; i < count; i++) {
        frames[i] = random_frame();
        channels[i] = (uint8_t)random_below(INTERFACES);
        directions[i] = (uint8_t)random_below(2);
    }
    uint8_t *const out = out_end - BYTES_MAX;
    check(!canser_capture_write(&capture, frames, channels, of == TAGGED_BLOCKS ? directions : NULL,
                                count, out, BYTES_MAX, &result) &&
              result.frame_count == count && !capture.unknown_times && !capture.outside_times,
          "write", of, round);
    const size_t len =
        of == RECORDS && random_below(2) ? shorten(out, result.byte_count) : result.byte_count;
    uint8_t *const data = bytes_end - len;
    memmove(data, out, len);
    if (is_big)
        turn(of, data, len);
    for (size_t i = 0; i < count; i++)
        frames[i].ext |= frames[i].err && frames[i].id > 0x7FF;

    capture = new_capture(of, is_big);
    size_t found = read_packets(&capture, data, len, got, got_channels, got_directions, &left);
    check(found == count && !left && !memcmp(got, frames, count * sizeof *got), "frames", of,
          round);
    bool same = found == count;
    for (size_t i = 0; same && i < count; i++)
        same = got_channels[i] == (of == RECORDS ? 0 : channels[i]) &&
               got_directions[i] == (of == TAGGED_BLOCKS ? directions[i] : CANSER_RECEIVED);
    check(same, "channels and directions", of, round);

    /* Damaged, no packet is more than unusual, or another frame of classic CAN. */
    for (size_t i = 1 + random_below(6); i; i--)
        data[random_below(len)] = (uint8_t)(random_below(2) ? random_below(256) : 0);
    for (size_t i = 0; i < INTERFACES; i++)
        canser_interface_init(&interfaces[i], random_below(2) ? 113 : 227, (uint8_t)i,
                              (uint8_t)random_below(256), (int64_t)random_word());
    found = read_packets(&capture, data, len, got, got_channels, got_directions, &left);
    bool valid = found <= FRAMES_MAX;
    for (size_t i = 0; valid && i < found; i++)
        valid = got[i].dlc <= 8 && got[i].id <= (got[i].ext ? 0x1FFFFFFFu : 0x7FFu) &&
                got_channels[i] < INTERFACES && got_directions[i] <= CANSER_SENT;
    check(valid, "damaged packets", of, round);
    for (size_t i = 0; i < INTERFACES; i++)
        canser_interface_init(&interfaces[i], 227, (uint8_t)i, 9, 0);
}

static void mistakes(kind of)
{
    canser_capture capture = new_capture(of, false);
    canser_frame frame = {.dlc = 9};
    canser_frame frames[4] = {{0}};
    uint8_t codes[4] = {0}, out[2 * CANSER_CAPTURED_MAX];
    canser_rows rows = {0};
    canser_encoded result;

    check(canser_interface_init(NULL, 227, 0, 9, 0) == CANSER_NULL, "no interface", of, 0);
    check(canser_capture_read(NULL, out, 1, &rows) == CANSER_NULL, "no state", of, 0);
    check(canser_capture_read(&capture, NULL, 1, &rows) == CANSER_NULL, "no data", of, 0);
    check(canser_capture_read(&capture, out, 1, NULL) == CANSER_NULL, "no rows", of, 0);
    rows.frame_cap = 1;
    check(canser_capture_read(&capture, out, 1, &rows) == CANSER_NULL, "no frames", of, 0);
    rows.frames = frames;
    rows.channels = rows.directions = codes;
    check(canser_capture_read(&capture, out, 1, &rows) == CANSER_OVERLAP, "rows overlap", of, 0);
    rows.directions = codes + 1;
    rows.frames = (canser_frame *)(void *)((uint8_t *)frames + 1);
    check(canser_capture_read(&capture, out, 1, &rows) == CANSER_MISALIGNED, "misaligned", of, 0);
    rows.frames = frames;
    check(canser_capture_read(&capture, (uint8_t *)frames, 8, &rows) == CANSER_OVERLAP,
          "data overlap", of, 0);
    check(canser_capture_read(&capture, out, 0, &rows) == CANSER_OK && !rows.is_unusual,
          "nothing to read", of, 0);
    capture.interfaces = NULL;
    check(canser_capture_read(&capture, out, 1, &rows) == CANSER_NULL, "no interfaces", of, 0);
    capture.interface_count = 0;
    check(canser_capture_read(&capture, out, 1, &rows) ==
              (of == RECORDS ? CANSER_RANGE : CANSER_OK),
          "interfaces that are none", of, 0);

    check(canser_capture_write(&capture, &frame, NULL, NULL, 1, out, sizeof out, NULL) ==
              CANSER_NULL,
          "no result", of, 0);
    check(canser_capture_write(&capture, &frame, NULL, NULL, 1, out, sizeof out, &result) ==
                  CANSER_REFUSED &&
              result.refusal == CANSER_REFUSAL_DLC && !result.frame_count,
          "a dlc of 9", of, 0);
    frame = (canser_frame){.id = 0x800};
    check(canser_capture_write(&capture, &frame, NULL, NULL, 1, out, sizeof out, &result) ==
              CANSER_REFUSED,
          "an id over its limit", of, 0);
    frame.id = 1;
    check(canser_capture_write(&capture, &frame, NULL, NULL, 1, out, CANSER_CAPTURED_MAX - 1,
                               &result) == CANSER_OK &&
              !result.frame_count,
          "no room", of, 0);
    check(canser_capture_write(&capture, &frame, NULL, NULL, 1, (uint8_t *)&frame, sizeof frame,
                               &result) == CANSER_OVERLAP,
          "overlap", of, 0);
    /* Two arrays that are only read may be one. */
    check(canser_capture_write(&capture, frames, codes, codes, 1, out, sizeof out, &result) ==
                  CANSER_OK &&
              result.frame_count == 1,
          "one array twice", of, 0);
    frames[0].ts = CANSER_NO_TIME;
    frames[1].ts = -1;
    frames[2].ts = INT64_MAX;
    canser_capture_write(&capture, frames, NULL, NULL, 2, out, sizeof out, &result);
    canser_capture_write(&capture, frames + 2, NULL, NULL, 1, out, sizeof out, &result);
    check(capture.unknown_times == 1 && capture.outside_times == (of == RECORDS ? 2u : 1u),
          "times that cannot be held", of, 0);
}

int main(int argc, char **argv)
{
    const size_t rounds = argc > 1 ? (size_t)strtoul(argv[1], NULL, 10) : 2000;

    bytes_end = guarded(BYTES_MAX);
    out_end = guarded(BYTES_MAX);
    channels_end = guarded(FRAMES_MAX);
    directions_end = guarded(FRAMES_MAX);
    frames_end = (canser_frame *)(void *)guarded(FRAMES_MAX * sizeof(canser_frame));
    interfaces = (canser_interface *)(void *)guarded(INTERFACES * sizeof(canser_interface));
    interfaces -= INTERFACES;
    for (size_t i = 0; i < INTERFACES; i++)
        canser_interface_init(&interfaces[i], 227, (uint8_t)i, 9, 0);
    for (kind of = RECORDS; of < KINDS; of++) {
        mistakes(of);
        for (size_t round = 0; round < rounds; round++)
            there_and_back(of, round % 2, round);
    }
    printf("%llu passed, %llu failed\n", passed, failed);
    return failed != 0;
}
