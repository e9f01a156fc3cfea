/* What canser.h promises of lines of text: what is written reads back, wherever the text is cut;
 * damaged lines are never more than left to the caller; and no memory but the caller's is touched.
 * Every array lies against a page that may not be touched. POSIX only. */
#include "guarded.h"

#include "canser.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES_MAX = 40, LINE_MOST = 160, TEXT_MAX = FRAMES_MAX * LINE_MOST };

static unsigned long long passed, failed;

static void check(bool holds, const char *what, const char *format, size_t round)
{
    if (holds)
        passed++;
    else if (failed++ < 10)
        printf("FAILED %s of %s, round %zu\n", what, format, round);
}

static uint8_t *text_end, *out_end, *channels_end, *directions_end;
static canser_frame *frames_end;

/* A frame that the format can hold, so that it reads back as it was. */
static canser_frame random_frame(const char *format)
{
    const bool plain = !strcmp(format, "gvret"), no_errors = plain || format[0] != 'c';
    canser_frame frame = {0};

    frame.ext = (uint8_t)random_below(2);
    frame.id = (uint32_t)random_below(frame.ext ? 0x20000000 : 0x800);
    frame.rtr = (uint8_t)(!plain && !random_below(4));
    frame.err = (uint8_t)(!no_errors && !frame.rtr && !random_below(4));
    if (frame.err)
        frame.ext = frame.id > 0x7FF;
    frame.dlc = (uint8_t)random_below(9);
    for (size_t i = 0; !frame.rtr && i < frame.dlc; i++)
        frame.data[i] = (uint8_t)random_below(256);
    frame.ts = (int64_t)random_below(UINT64_C(1) << 44) * 1000;
    return frame;
}

static canser_text new_text(size_t index)
{
    canser_text text = {.format = canser_text_at(index)};

    if (!strcmp(text.format->name, "trc"))
        memcpy(text.columns, "NOTBIdRLD", 10);
    else if (!strcmp(text.format->name, "gvret"))
        text.columns[0] = 'd';
    canser_text_add_name(&text, "can0", 4, 0);
    canser_text_add_name(&text, "a-long.name_15c", 15, 1);
    return text;
}

/* Write frames; return the text, which ends at a page that may not be touched. */
static const uint8_t *write_text(size_t index, const canser_frame *frames, const uint8_t *channels,
                                 const uint8_t *directions, size_t count, size_t *len)
{
    canser_text text = new_text(index);
    canser_encoded result;
    uint8_t *const out = out_end - TEXT_MAX;

    check(!canser_text_write(&text, frames, channels, directions, count, out, TEXT_MAX, &result) &&
              result.frame_count == count,
          "write", text.format->name, count);
    *len = result.byte_count;
    memmove(text_end - *len, out, *len);
    return text_end - *len;
}

/* Read a text in pieces, cut at random; unusual lines are skipped. Return the frames. */
static size_t read_text(size_t index, const uint8_t *data, size_t len, canser_frame *frames,
                        uint8_t *channels, uint8_t *directions, size_t *unusual)
{
    canser_text text = new_text(index);
    size_t count = 0, used = 0, avail = 0;

    *unusual = 0;
    while (used < len) {
        const size_t cap = 1 + random_below(5), left = FRAMES_MAX - count;
        canser_rows rows = {.frame_cap = cap < left ? cap : left};
        rows.frames = frames_end - rows.frame_cap;
        rows.channels = channels_end - rows.frame_cap;
        rows.directions = directions_end - rows.frame_cap;
        avail += random_below(2) ? len - avail : random_below(len - avail + 1);
        /* The bytes lie at the end of their pages, so that reading on is a crash. */
        uint8_t *const at = out_end - (avail - used);
        memcpy(at, data + used, avail - used);
        if (canser_text_read(&text, at, avail - used, &rows))
            return FRAMES_MAX + 1;
        memcpy(frames + count, rows.frames, rows.frame_count * sizeof *frames);
        memcpy(channels + count, rows.channels, rows.frame_count);
        memcpy(directions + count, rows.directions, rows.frame_count);
        count += rows.frame_count;
        used += rows.used;
        if (rows.is_unusual || (avail == len && rows.frame_count < rows.frame_cap && used < len)) {
            const uint8_t *const end = memchr(data + used, '\n', len - used);
            used = end ? (size_t)(end + 1 - data) : len;
            avail = avail < used ? used : avail;
            ++*unusual;
        }
        if (count == FRAMES_MAX)
            break;
    }
    return count;
}

static void there_and_back(size_t index, size_t round)
{
    canser_frame frames[FRAMES_MAX], got[FRAMES_MAX];
    uint8_t channels[FRAMES_MAX], directions[FRAMES_MAX], got_channels[FRAMES_MAX],
        got_directions[FRAMES_MAX];
    const char *const name = canser_text_at(index)->name;
    const size_t count = 1 + random_below(FRAMES_MAX - 1);
    size_t len, unusual;

    for (size_t i = 0; i < count; i++) {
        frames[i] = random_frame(name);
        channels[i] = (uint8_t)random_below(2);
        directions[i] = (uint8_t)random_below(2);
    }
    const uint8_t *text = write_text(index, frames, channels, directions, count, &len);
    size_t found = read_text(index, text, len, got, got_channels, got_directions, &unusual);
    check(found == count && !unusual && !memcmp(got, frames, count * sizeof *got), "frames", name,
          round);
    if (strcmp(name, "csv"))
        check(!memcmp(got_channels, channels, count) && !memcmp(got_directions, directions, count),
              "channels and directions", name, round);

    /* Damaged, no line is more than unusual, or another frame of classic CAN. */
    uint8_t *const damaged = text_end - len;
    for (size_t i = 1 + random_below(4); i; i--)
        damaged[random_below(len)] = (uint8_t)(random_below(4) ? random_below(128) : '\n');
    found = read_text(index, damaged, len, got, got_channels, got_directions, &unusual);
    bool valid = found <= FRAMES_MAX;
    for (size_t i = 0; valid && i < found; i++)
        valid = got[i].dlc <= 8 && got[i].id <= (got[i].ext ? 0x1FFFFFFFu : 0x7FFu);
    check(valid, "damaged lines", name, round);
}

/* A line of which each run of blanks is as long as a run may be is read, or left to the caller,
 * wherever it is cut: no byte behind the cut is looked at. */
static void long_blanks(size_t index, size_t round)
{
    enum { RUN = 63 };
    const canser_frame frame = random_frame(canser_text_at(index)->name);
    const uint8_t channel = 0, direction = 1;
    size_t len, wide_len = 0;
    const uint8_t *const line = write_text(index, &frame, &channel, &direction, 1, &len);
    uint8_t wide[TEXT_MAX];

    for (size_t i = 0; i < len; i++) {
        const size_t run = line[i] == ' ' && (!i || line[i - 1] != ' ') ? RUN : line[i] != ' ';
        memset(wide + wide_len, line[i], run);
        wide_len += run;
    }
    for (size_t cut = 1; cut <= wide_len; cut++) {
        canser_text text = new_text(index);
        canser_frame got;
        uint8_t codes[2], *const at = out_end - cut;
        canser_rows rows = {.frames = &got, .channels = codes, .directions = codes + 1};

        rows.frame_cap = 1;
        memcpy(at, wide, cut);
        const int status = canser_text_read(&text, at, cut, &rows);
        const bool same = rows.used == cut && !memcmp(&got, &frame, sizeof got);
        check(!status && (rows.frame_count ? cut == wide_len && same : !rows.used), "long blanks",
              text.format->name, round);
    }
}

static void mistakes(size_t index)
{
    canser_text text = new_text(index);
    const char *const name = text.format->name;
    canser_frame frame = {.dlc = 9};
    canser_rows rows = {0};
    canser_encoded result;
    uint8_t out[LINE_MOST];

    check(canser_text_read(NULL, out, 1, &rows) == CANSER_NULL, "no state", name, 0);
    check(canser_text_read(&text, NULL, 1, &rows) == CANSER_NULL, "no data", name, 0);
    check(canser_text_read(&text, out, 1, NULL) == CANSER_NULL, "no rows", name, 0);
    rows.frame_cap = 1;
    check(canser_text_read(&text, out, 1, &rows) == CANSER_NULL, "no frames", name, 0);
    check(canser_text_write(&text, &frame, NULL, NULL, 1, out, sizeof out, &result) ==
                  CANSER_REFUSED &&
              result.refusal == CANSER_REFUSAL_DLC && !result.frame_count,
          "a dlc of 9", name, 0);
    frame = (canser_frame){.id = 0x800};
    check(canser_text_write(&text, &frame, NULL, NULL, 1, out, sizeof out, &result) ==
              CANSER_REFUSED,
          "an id over its limit", name, 0);
    frame.id = 1;
    check(canser_text_write(&text, &frame, NULL, NULL, 1, out, LINE_MOST - 1, &result) ==
                  CANSER_OK &&
              !result.frame_count,
          "no room", name, 0);
    check(canser_text_write(&text, &frame, NULL, NULL, 1, (uint8_t *)&frame, sizeof frame,
                            &result) == CANSER_OVERLAP,
          "overlap", name, 0);
    check(canser_text_add_name(&text, "", 0, 1) == CANSER_RANGE, "no name", name, 0);
    check(canser_text_add_name(&text, "sixteen-letters.", 16, 1) == CANSER_RANGE, "a long name",
          name, 0);
    for (int i = 2; i < CANSER_NAMES_MAX; i++)
        canser_text_add_name(&text, "x", 1, 1);
    check(canser_text_add_name(&text, "x", 1, 1) == CANSER_RANGE, "many names", name, 0);
}

int main(int argc, char **argv)
{
    const size_t rounds = argc > 1 ? (size_t)strtoul(argv[1], NULL, 10) : 2000;

    text_end = guarded(TEXT_MAX);
    out_end = guarded(TEXT_MAX);
    channels_end = guarded(FRAMES_MAX);
    directions_end = guarded(FRAMES_MAX);
    frames_end = (canser_frame *)(void *)guarded(FRAMES_MAX * sizeof(canser_frame));
    for (size_t index = 0; canser_text_at(index); index++) {
        mistakes(index);
        for (size_t round = 0; round < rounds; round++)
            there_and_back(index, round);
        for (size_t round = 0; round < 20; round++)
            long_blanks(index, round);
    }
    printf("%llu passed, %llu failed\n", passed, failed);
    return failed != 0;
}
