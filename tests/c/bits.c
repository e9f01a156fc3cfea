/* The lengths of frames on the bus: those of the bits one by one, on random frames of all kinds,
 * with long runs of equal bits, in every place of a call; and no byte touched past an array.
 *
 *     bits [frames]
 */
#include "guarded.h"

#include "canser.h"
#include "plain_bits.h"

#include <stdbool.h>
#include <string.h>

enum { BATCH = 64 };

static unsigned long passed, failed;
static canser_bits tables;

static void check(bool holds, const char *what)
{
    passed += holds;
    failed += !holds;
    if (!holds && failed < 10)
        printf("FAILED %s\n", what);
}

static void make_frame(canser_frame *frame)
{
    static const uint8_t runs[] = {0x00, 0xFF, 0x0F, 0xF0, 0x55, 0x1F, 0x83};
    const size_t kind = random_below(4);

    memset(frame, 0, sizeof *frame);
    frame->ext = random_below(2) == 1;
    frame->rtr = random_below(8) == 0;
    frame->err = random_below(50) == 0;
    frame->id = (uint32_t)(random_below(3) ? random_word() : random_below(2) ? 0 : UINT32_MAX);
    frame->id &= frame->ext ? 0x1FFFFFFF : 0x7FF;
    frame->dlc = (uint8_t)(random_below(20) ? random_below(9) : random_below(16));
    for (unsigned i = 0; i < 8; i++)
        frame->data[i] = kind ? (uint8_t)random_word() : runs[random_below(sizeof runs)];
    frame->ts = (int64_t)random_word();
}

int main(int argc, char **argv)
{
    const size_t frame_count = argc > 1 ? strtoul(argv[1], NULL, 10) : 100000;
    canser_frame *const end = (canser_frame *)(void *)guarded(BATCH * sizeof *end);
    uint8_t *const bits_end = guarded(BATCH);
    bool are_equal = true;

    check(canser_bits_init(NULL) == CANSER_NULL, "no tables");
    check(canser_bits_init(&tables) == CANSER_OK, "tables");
    for (size_t done = 0; done < frame_count;) {
        const size_t count = 1 + random_below(BATCH);
        canser_frame *const frames = end - count;
        uint8_t *const bits = bits_end - count;

        for (size_t i = 0; i < count; i++)
            make_frame(&frames[i]);
        check(canser_frame_bits(&tables, frames, count, bits) == CANSER_OK, "a call");
        for (size_t i = 0; i < count; i++)
            are_equal &= bits[i] == plain_length(&frames[i]);
        done += count;
    }
    check(are_equal, "lengths");
    check(canser_frame_bits(NULL, end - 1, 1, bits_end - 1) == CANSER_NULL, "no tables");
    check(canser_frame_bits(&tables, NULL, 1, bits_end - 1) == CANSER_NULL, "no frames");
    check(canser_frame_bits(&tables, end - 1, 1, NULL) == CANSER_NULL, "no bits");
    check(canser_frame_bits(&tables, NULL, 0, NULL) == CANSER_OK, "nothing");
    check(canser_frame_bits(&tables, (canser_frame *)(void *)((char *)(end - 1) - 1), 1,
                            bits_end - 1) == CANSER_MISALIGNED,
          "misaligned");
    printf("%lu passed, %lu failed\n", passed, failed);
    return failed != 0;
}
