/* What canser.h promises of objects of BLF: what is written reads back, wherever the bytes are cut;
 * objects of any type and size are frames of classic CAN, or none; and no memory but the caller's
 * is touched. Every array lies against a page that may not be touched. POSIX only. */
#include "guarded.h"

#include "canser.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_MAX = 40, OBJECT_MAX = 40 + 40 + 64 + 8, BYTES_MAX = FRAMES_MAX * OBJECT_MAX };

static unsigned long long passed, failed;

static void check(bool holds, const char *what, size_t round)
{
    if (holds)
        passed++;
    else if (failed++ < 10)
        printf("FAILED %s, round %zu\n", what, round);
}

static uint8_t *bytes_end, *channels_end, *directions_end;
static canser_frame *frames_end;

/* Frames with all that a file tells of them. */
typedef struct {
    canser_frame frames[FRAMES_MAX];
    uint8_t channels[FRAMES_MAX];
    uint8_t directions[FRAMES_MAX];
    size_t count;
} told;

static bool same(const told *a, const told *b)
{
    return a->count == b->count && !memcmp(a->frames, b->frames, a->count * sizeof *a->frames) &&
           !memcmp(a->channels, b->channels, a->count) &&
           !memcmp(a->directions, b->directions, a->count);
}

static void random_frames(told *made, int64_t start_ns)
{
    memset(made, 0, sizeof *made);
    made->count = random_below(FRAMES_MAX + 1);
    for (size_t i = 0; i < made->count; i++) {
        canser_frame *const frame = &made->frames[i];
        frame->ext = (uint8_t)random_below(2);
        frame->id = (uint32_t)random_below(frame->ext ? 0x20000000 : 0x800);
        frame->rtr = (uint8_t)!random_below(4);
        frame->err = (uint8_t)(!frame->rtr && !random_below(4));
        if (frame->err) /* the kind of its frame follows from the id */
            frame->ext = frame->ext || frame->id > 0x7FF;
        frame->dlc = (uint8_t)random_below(9);
        for (size_t j = 0; !frame->rtr && j < frame->dlc; j++)
            frame->data[j] = (uint8_t)random_below(256);
        frame->ts = start_ns + (int64_t)(random_word() >> 2);
        made->channels[i] = (uint8_t)random_below(CANSER_NO_CHANNEL);
        made->directions[i] = (uint8_t)random_below(2);
    }
}

/* Read bytes in pieces, cut at random, or at once. Containers and what is damaged end it; return
 * the number of bytes that were taken. */
static size_t read_bytes(canser_blf *blf, const uint8_t *data, size_t len, bool in_pieces,
                         told *got)
{
    size_t used = 0, avail = in_pieces ? 0 : len;

    memset(got, 0, sizeof *got);
    for (;;) {
        const size_t left = FRAMES_MAX - got->count;
        size_t cap = in_pieces ? 1 + random_below(5) : left;
        cap = cap < left ? cap : left;
        canser_rows rows = {.frame_cap = cap};
        rows.frames = frames_end - cap;
        rows.channels = channels_end - cap;
        rows.directions = directions_end - cap;
        /* The bytes lie at the end of their pages, so that reading on is a crash. */
        uint8_t *const at = bytes_end - (avail - used);
        memcpy(at, data + used, avail - used);
        if (canser_blf_read(blf, at, avail - used, &rows) || rows.used > avail - used ||
            rows.frame_count > cap || rows.frame_count > rows.line_count)
            return SIZE_MAX;
        memcpy(got->frames + got->count, rows.frames, rows.frame_count * sizeof *got->frames);
        memcpy(got->channels + got->count, rows.channels, rows.frame_count);
        memcpy(got->directions + got->count, rows.directions, rows.frame_count);
        got->count += rows.frame_count;
        used += rows.used;
        const bool is_damaged =
            blf->stopped == CANSER_BLF_SIGNATURE || blf->stopped == CANSER_BLF_SIZE;
        if (rows.is_unusual != is_damaged)
            return SIZE_MAX;
        if (is_damaged || blf->stopped == CANSER_BLF_CONTAINER || got->count == FRAMES_MAX)
            return used;
        if (blf->stopped == CANSER_BLF_MORE) {
            if (avail == len)
                return used;
            avail += random_below(2) ? len - avail : random_below(len - avail + 1);
        }
    }
}

static void there_and_back(size_t round)
{
    static uint8_t out[FRAMES_MAX * CANSER_BLF_WRITTEN_MAX];
    const int64_t start_ns = (int64_t)(random_word() >> 3);
    canser_blf writer = {.start_ns = start_ns}, reader = {0};
    canser_encoded result;
    told made, got;

    random_frames(&made, start_ns);
    const size_t cap = made.count * CANSER_BLF_WRITTEN_MAX;
    uint8_t *const room = bytes_end - cap;
    check(!canser_blf_write(&writer, made.frames, made.channels, made.directions, made.count, room,
                            cap, &result) &&
              result.frame_count == made.count && result.byte_count <= cap,
          "write", round);
    memcpy(out, room, result.byte_count);

    told expected = made;
    for (size_t i = 0; i < made.count; i++)
        expected.frames[i].ts -= start_ns;
    const size_t used = read_bytes(&reader, out, result.byte_count, true, &got);
    check(used == result.byte_count && same(&got, &expected), "frames", round);
}

static void put_le(uint8_t *p, uint64_t value, int count)
{
    for (int i = 0; i < count; i++)
        p[i] = (uint8_t)(value >> 8 * i);
}

/* Put an object of a type that is known or not, mostly as long as its type needs. */
static size_t put_object(uint8_t *p)
{
    static const struct {
        uint8_t type, len;
    } types[] = {{1, 16},   {2, 4},    {73, 32},  {86, 16},  {86, 24},
                 {100, 84}, {101, 40}, {104, 20}, {115, 24}, {101, 48}};
    const size_t row = random_below(sizeof types / sizeof *types);
    const size_t header = random_below(4) ? 32 : random_below(9) ? 40 : 16;
    const size_t len =
        header + types[row].len + random_below(12) / 11 - (random_below(12) ? 0 : random_below(5));

    for (size_t i = 0; i < len; i++) /* small values make valid fields */
        p[i] = (uint8_t)(random_below(3) ? random_below(9) : random_below(256));
    memcpy(p, "LOBJ", 4);
    put_le(p + 4, header, 2);
    put_le(p + 6, header == 40 ? 2 : 1, 2);
    put_le(p + 8, random_below(50) ? len : random_below(200), 4);
    put_le(p + 12, types[row].type, 4);
    if (header > 16)
        put_le(p + 16, 1 + random_below(2), 4);
    const size_t padding = random_below(2) ? len % 4 : random_below(2) * random_below(9);
    memset(p + len, 0, padding);
    return len + padding;
}

/* Any objects, some of them damaged: the result does not depend on the cuts. */
static void any_objects(size_t round)
{
    static uint8_t data[BYTES_MAX];
    canser_blf once = {0}, often = {0};
    told whole, parts;
    size_t len = 0;

    for (size_t i = random_below(random_below(2) ? FRAMES_MAX : 4); i; i--)
        len += put_object(data + len);
    if (len && !random_below(3))
        data[random_below(len)] = (uint8_t)random_below(256);
    const size_t used = read_bytes(&once, data, len, false, &whole);
    const size_t used_in_parts = read_bytes(&often, data, len, true, &parts);
    check(used <= len && used == used_in_parts && same(&whole, &parts) &&
              once.fd_count == often.fd_count && once.odd_frames == often.odd_frames &&
              once.odd_errors == often.odd_errors && once.lost_channels == often.lost_channels &&
              once.lost_times == often.lost_times,
          "any objects, cut", round);
    bool valid = true;
    for (size_t i = 0; i < whole.count; i++) {
        const canser_frame *const frame = &whole.frames[i];
        valid = valid && frame->dlc <= 8 && frame->id <= (frame->ext ? 0x1FFFFFFFu : 0x7FFu) &&
                frame->ext <= 1 && frame->rtr <= 1 && frame->err <= 1;
        for (size_t j = frame->rtr ? 0 : frame->dlc; j < 8; j++)
            valid = valid && !frame->data[j];
    }
    check(valid, "frames of any objects", round);
}

static void mistakes(void)
{
    canser_blf blf = {0};
    canser_frame frame = {.dlc = 9};
    canser_rows rows = {.used = 7, .frame_count = 7};
    canser_encoded result;
    uint8_t out[CANSER_BLF_WRITTEN_MAX] = "LOBJ", code = 0;

    check(canser_blf_read(NULL, out, 1, &rows) == CANSER_NULL && !rows.used && !rows.frame_count,
          "no state", 0);
    check(canser_blf_read(&blf, NULL, 1, &rows) == CANSER_NULL, "no data", 0);
    check(canser_blf_read(&blf, out, 1, NULL) == CANSER_NULL, "no rows", 0);
    check(!canser_blf_read(&blf, NULL, 0, &rows) && blf.stopped == CANSER_BLF_FULL, "nothing", 0);
    rows.frame_cap = 1;
    rows.channels = rows.directions = &code;
    check(canser_blf_read(&blf, out, 1, &rows) == CANSER_NULL, "no frames", 0);
    rows.frames = &frame;
    check(canser_blf_read(&blf, out, 1, &rows) == CANSER_OVERLAP, "one array of codes", 0);
    rows.directions = NULL;
    check(canser_blf_read(&blf, out, 1, &rows) == CANSER_NULL, "no directions", 0);
    rows.directions = (uint8_t *)&result;
    check(canser_blf_read(&blf, (uint8_t *)&frame, 1, &rows) == CANSER_OVERLAP, "overlap", 0);

    check(canser_blf_write(&blf, &frame, NULL, NULL, 1, out, sizeof out, NULL) == CANSER_NULL,
          "no result", 0);
    check(canser_blf_write(NULL, &frame, NULL, NULL, 1, out, sizeof out, &result) == CANSER_NULL,
          "no state to write", 0);
    check(canser_blf_write(&blf, &frame, NULL, NULL, 1, out, sizeof out, &result) ==
                  CANSER_REFUSED &&
              result.refusal == CANSER_REFUSAL_DLC && !result.frame_count,
          "a dlc of 9", 0);
    frame = (canser_frame){.id = 0x800};
    check(canser_blf_write(&blf, &frame, NULL, NULL, 1, out, sizeof out, &result) == CANSER_REFUSED,
          "an id over its limit", 0);
    frame.id = 1;
    check(!canser_blf_write(&blf, &frame, NULL, NULL, 1, out, sizeof out - 1, &result) &&
              !result.frame_count,
          "no room", 0);
    check(canser_blf_write(&blf, &frame, NULL, NULL, 1, (uint8_t *)&frame, sizeof frame, &result) ==
              CANSER_OVERLAP,
          "overlap of frames", 0);
}

int main(int argc, char **argv)
{
    const size_t rounds = argc > 1 ? (size_t)strtoul(argv[1], NULL, 10) : 5000;

    bytes_end = guarded(BYTES_MAX);
    channels_end = guarded(FRAMES_MAX);
    directions_end = guarded(FRAMES_MAX);
    frames_end = (canser_frame *)(void *)guarded(FRAMES_MAX * sizeof(canser_frame));
    mistakes();
    for (size_t round = 0; round < rounds; round++) {
        there_and_back(round);
        any_objects(round);
    }
    printf("%llu passed, %llu failed\n", passed, failed);
    return failed != 0;
}
