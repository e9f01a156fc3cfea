/* Frames that are encoded, and why one is refused: as plain.c has it, with any room for the bytes,
 * and no memory but the caller's is touched. */
#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

enum { FRAMES_MAX = 12 /* of an encoding */ };

/* Encode into `cap` bytes, and say what must come of it: frames up to the first
 * that does not fit or is refused. */
static void check_encode(const canser_frame *frames, size_t count, int64_t tick_ns, size_t cap)
{
    const size_t frames_size = count * sizeof *frames;
    uint8_t expected[FRAMES_MAX * CANSER_PACKET_MAX];
    canser_encoded result = {SIZE_MAX, SIZE_MAX, -1};
    size_t expected_count = 0, expected_len = 0;
    int refusal = CANSER_REFUSAL_NONE;

    for (; expected_count < count; expected_count++) {
        uint8_t packet[CANSER_PACKET_MAX];
        const size_t len =
            plain_encode(now.protocol, tick_ns, &frames[expected_count], packet, &refusal);
        if (refusal != CANSER_REFUSAL_NONE || len > cap - expected_len)
            break;
        memcpy(expected + expected_len, packet, len);
        expected_len += len;
    }

    canser_frame *const in = place(DRIVE_FRAMES, frames_size);
    uint8_t *const out = place(DRIVE_INPUT, cap);
    memcpy(in, frames, frames_size);
    const int status = canser_encode(canser_protocol_at((size_t)now.protocol), tick_ns, in, count,
                                     out, cap, &result);

    check(status == (refusal ? CANSER_REFUSED : CANSER_OK), "the status of encode differs");
    check(result.refusal == refusal, "the refusal differs");
    check(result.frame_count == expected_count, "the number of frames encoded differs");
    check(result.byte_count == expected_len, "the number of bytes encoded differs");
    if (result.byte_count == expected_len)
        check(memcmp(out, expected, expected_len) == 0, "the bytes encoded differ");
    check(memcmp(in, frames, frames_size) == 0, "the frames were written to");
    drop(DRIVE_FRAMES, in, frames_size);
    drop(DRIVE_INPUT, out, cap);
}

/* Ask why each frame cannot be carried, and say what must come of it. */
static void check_refuse(const canser_frame *frames, size_t count)
{
    const size_t frames_size = count * sizeof *frames;
    canser_frame *const in = place(DRIVE_FRAMES, frames_size);
    uint8_t *const refusals = place(DRIVE_INPUT, count);

    memcpy(in, frames, frames_size);
    check(canser_refuse(canser_protocol_at((size_t)now.protocol), in, count, refusals) == CANSER_OK,
          "the status of refuse differs");
    for (size_t i = 0; i < count; i++) {
        uint8_t packet[CANSER_PACKET_MAX];
        int refusal = CANSER_REFUSAL_NONE;

        plain_encode(now.protocol, 1000, &frames[i], packet, &refusal);
        check(refusals[i] == refusal, "refuse gives another reason");
    }
    check(memcmp(in, frames, frames_size) == 0, "the frames were written to");
    drop(DRIVE_FRAMES, in, frames_size);
    drop(DRIVE_INPUT, refusals, count);
}

void test_encode(void)
{
    static const int64_t ticks[] = {1, 7, 1000, 1000000, 1000000000};
    canser_frame frames[FRAMES_MAX];

    begin_part("encode");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (size_t round = 0; round < 4 * FRAMES_MAX; round++) {
            const size_t count = round % (FRAMES_MAX + 1);
            const int64_t tick_ns = ticks[random_below(5)];
            const int refusal = (int)random_below(CANSER_REFUSAL_COUNT);

            for (size_t i = 0; i < count; i++)
                frames[i] = random_frame(now.protocol);
            now.kind = CANSER_REFUSAL_NONE;
            if (count && refusal != CANSER_REFUSAL_NONE) {
                canser_frame bad = random_frame(now.protocol);
                if (spoil(now.protocol, refusal, &bad)) {
                    frames[random_below(count)] = bad;
                    now.kind = refusal;
                }
            }
            now.frame_cap = count;
            for (int side = 0; side < 2; side++) {
                now.at_end = side;
                for (size_t cap = 0; cap <= count * CANSER_PACKET_MAX; cap++) {
                    now.len = cap;
                    now.shift = side ? 0 : cap % (SHIFT_MAX + 1);
                    check_encode(frames, count, tick_ns, cap);
                }
            }
            now.shift = 0;
            check_refuse(frames, count);
        }
    }
}

/* The refusals one by one, each at its own index. */
void test_refusals(void)
{
    begin_part("refusals");
    now.at_end = true;
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (int refusal = 1; refusal < CANSER_REFUSAL_COUNT; refusal++) {
            canser_frame frames[FRAMES_MAX];
            const size_t index = (size_t)refusal;
            canser_frame bad = random_frame(now.protocol);
            if (!spoil(now.protocol, refusal, &bad))
                continue;

            uint8_t out[FRAMES_MAX * CANSER_PACKET_MAX];
            canser_encoded result;
            for (size_t i = 0; i < FRAMES_MAX; i++)
                frames[i] = random_frame(now.protocol);
            frames[index] = bad;
            now.kind = refusal;
            check(canser_encode(canser_protocol_at((size_t)now.protocol), 1000, frames, FRAMES_MAX,
                                out, sizeof out, &result) == CANSER_REFUSED,
                  "a frame that cannot be carried is not refused");
            check(result.refusal == refusal, "a frame is refused for another reason");
            check(result.frame_count == index, "another frame is refused");
            check_refuse(frames, FRAMES_MAX);
        }
    }
}
