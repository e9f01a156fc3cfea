/* Frames that change: those that a plain loop finds, however small the arrays are and with few
 * places for ids; no byte touched past an array, and the errors of each call.
 *
 *     changes [rounds]
 */
#include "guarded.h"

#include "canser.h"
#include "checks.h"

#include <string.h>

/* A run with many frames copies them past the cache. */
enum { FRAMES = 2000, MANY = 600000 };

static canser_frame random_frame(size_t different)
{
    canser_frame frame;

    memset(&frame, 0, sizeof frame);
    frame.id = (uint32_t)random_below(random_below(9) ? 3 : different);
    frame.ext = random_below(3) == 0;
    frame.rtr = random_below(9) == 0;
    frame.err = random_below(9) == 0;
    frame.dlc = (uint8_t)(random_below(9) ? 8 : random_below(9));
    frame.data[random_below(8)] = (uint8_t)random_below(2);
    frame.ts = (int64_t)random_word();
    return frame;
}

static bool are_of_one_id(const canser_frame *a, const canser_frame *b)
{
    return a->id == b->id && a->ext == b->ext && a->rtr == b->rtr && a->err == b->err;
}

/* Put the frames that change into `out`, by looking back for the one before. */
static size_t change_plainly(const canser_frame *frames, const uint8_t *channels, size_t count,
                             canser_frame *out)
{
    size_t found = 0;

    for (size_t i = 0; i < count; i++) {
        size_t j = i;

        while (j && !(are_of_one_id(&frames[j - 1], &frames[i]) &&
                      (!channels || channels[j - 1] == channels[i])))
            j--;
        if (!j || frames[j - 1].dlc != frames[i].dlc ||
            memcmp(frames[j - 1].data, frames[i].data, 8) != 0)
            out[found++] = frames[i];
    }
    return found;
}

/* The ends of memory behind which a page may not be touched. */
static canser_frame *frames_end, *part_end;
static uint8_t *channels_end;

/* Find them with as many places for ids as are needed, `room` frames of the result at a time. */
static size_t change(const canser_frame *frames, const uint8_t *channels, size_t count,
                     canser_frame *out, size_t room)
{
    canser_frame *const part = part_end - room;
    canser_changes changes = {.spread = random_word() | 1};
    size_t done = 0, found = 0, cap = 2;

    check(canser_changes_move(&changes, malloc(cap * sizeof *changes.lasts), cap) == CANSER_OK,
          "begin");
    while (done < count) {
        size_t used, part_count;

        check(canser_changes_add(&changes, frames + done, count - done,
                                 channels ? channels + done : NULL, part, room, &used,
                                 &part_count) == CANSER_OK,
              "add");
        memcpy(out + found, part, part_count * sizeof *out);
        done += used;
        found += part_count;
        if (done < count && part_count < room) {
            canser_last *const before = changes.lasts;

            cap *= 2;
            check(canser_changes_move(&changes, malloc(cap * sizeof *before), cap) == CANSER_OK,
                  "move");
            free(before);
        }
    }
    check(2 * changes.count <= cap, "half of the places");
    free(changes.lasts);
    return found;
}

static void run_round(void)
{
    const size_t count = 1 + random_below(FRAMES);
    const bool is_told = random_below(2);
    canser_frame *const frames = frames_end - count;
    uint8_t *const channels = channels_end - count;
    canser_frame *const expected = malloc(2 * count * sizeof *frames), *const out =
                                                                           expected + count;
    size_t wanted;

    for (size_t i = 0; i < count; i++) {
        frames[i] = random_frame(random_below(2) ? 9 : 0x20000000);
        channels[i] = (uint8_t)(random_below(3) ? 255 : random_below(2));
    }
    wanted = change_plainly(frames, is_told ? channels : NULL, count, expected);
    for (size_t room = 1; room < 2 * count; room += 1 + room * random_below(9))
        check(change(frames, is_told ? channels : NULL, count, out, room) == wanted &&
                  !memcmp(out, expected, wanted * sizeof *out),
              "the frames that change");
    free(expected);
}

/* Many frames, of which all change, or few: as their first ones alone are. */
static void run_many(void)
{
    canser_frame *const frames = malloc(2 * MANY * sizeof *frames), *const out = frames + MANY;
    canser_last lasts[64];

    for (uint64_t each = 1; each < 5; each += 3) {
        canser_changes changes = {.spread = random_word() | 1};
        const size_t full = MANY / (7 * each), rest = MANY % (7 * each);
        size_t used, count;
        bool are_right = true;

        for (size_t i = 0; i < MANY; i++) {
            const uint64_t data = i / 7 / each;

            frames[i] = (canser_frame){.id = (uint32_t)(i % 7), .dlc = 8, .ts = (int64_t)i};
            memcpy(frames[i].data, &data, sizeof data);
        }
        check(canser_changes_move(&changes, lasts, 64) == CANSER_OK, "begin");
        check(canser_changes_add(&changes, frames, MANY, NULL, out, MANY, &used, &count) ==
                      CANSER_OK &&
                  used == MANY,
              "many");
        for (size_t i = 0; i < count; i++)
            are_right &= !memcmp(&out[i], &frames[i / 7 * 7 * each + i % 7], sizeof *out);
        check(are_right && count == full * 7 + (rest < 7 ? rest : 7), "many are right");
    }
    free(frames);
}

static void check_errors(void)
{
    canser_frame frames[2];
    canser_last lasts[8];
    canser_changes one = {.spread = 1};
    size_t used = 1, count = 1;
    const canser_frame *const odd = (const canser_frame *)(const void *)((const char *)frames + 1);

    memset(frames, 0, sizeof frames);
    check(canser_changes_add(&one, frames, 1, NULL, frames, 1, &used, &count) == CANSER_NULL &&
              !used && !count,
          "no places");
    check(canser_changes_move(&one, NULL, 8) == CANSER_NULL, "nowhere");
    check(canser_changes_move(NULL, lasts, 8) == CANSER_NULL, "nothing");
    check(canser_changes_move(&one, lasts, 6) == CANSER_RANGE, "no power of two");
    check(canser_changes_move(&one, lasts, 8) == CANSER_OK, "move");
    check(canser_changes_add(NULL, frames, 1, NULL, frames, 1, &used, &count) == CANSER_NULL,
          "null");
    check(canser_changes_add(&one, NULL, 1, NULL, frames, 1, &used, &count) == CANSER_NULL,
          "no frames");
    check(canser_changes_add(&one, frames, 1, NULL, NULL, 1, &used, &count) == CANSER_NULL,
          "no out");
    check(canser_changes_add(&one, frames, 1, NULL, NULL, 0, &used, &count) == CANSER_OK && !used,
          "no room");
    check(canser_changes_add(&one, odd, 1, NULL, frames, 1, &used, &count) == CANSER_MISALIGNED,
          "odd");
    check(canser_changes_add(&one, frames, 0, NULL, NULL, 0, &used, &count) == CANSER_OK, "none");
    one.cap = 6;
    check(canser_changes_add(&one, frames, 1, NULL, frames, 1, &used, &count) == CANSER_RANGE,
          "an unfit cap");
    one.cap = 8;
    one.count = 3;
    check(canser_changes_move(&one, lasts, 4) == CANSER_RANGE, "too few places");
}

int main(int argc, char **argv)
{
    const unsigned long rounds = argc > 1 ? strtoul(argv[1], NULL, 10) : 100;

    frames_end = (canser_frame *)(void *)guarded(FRAMES * sizeof *frames_end);
    part_end = (canser_frame *)(void *)guarded(2 * FRAMES * sizeof *part_end);
    channels_end = guarded(FRAMES);
    check_errors();
    run_many();
    for (unsigned long i = 0; i < rounds; i++)
        run_round();
    return told();
}
