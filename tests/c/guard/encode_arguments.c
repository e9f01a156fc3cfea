/* The caller's mistakes in calls of canser_encode() and canser_refuse(), and calls without frames
 * or without room. */
#include "arena.h"
#include "checks.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

static void check_encode_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    canser_frame frames[3];
    uint8_t out[3 * CANSER_PACKET_MAX];
    canser_encoded result;

    memset(out, UNUSED_BYTE, sizeof out);
    for (size_t i = 0; i < 2; i++)
        frames[i] = random_frame(now.protocol);

    const struct {
        const char *what;
        int status;
        const canser_protocol *protocol;
        const canser_frame *frames;
        size_t frame_count;
        uint8_t *out;
        size_t out_cap;
    } calls[] = {
        {"encode: protocol NULL", CANSER_NULL, NULL, frames, 2, out, sizeof out},
        {"encode: frames NULL", CANSER_NULL, protocol, NULL, 1, out, sizeof out},
        {"encode: out NULL", CANSER_NULL, protocol, frames, 2, NULL, 1},
        {"encode: misaligned", CANSER_MISALIGNED, protocol, behind(frames, 1), 2, out, sizeof out},
        {"encode: out on frames", CANSER_OVERLAP, protocol, frames, 2, behind(frames, 47), 20},
        {"encode: frames on out", CANSER_OVERLAP, protocol, frames + 1, 2, behind(frames, 0), 25},
        {"encode: no frames", CANSER_OK, protocol, NULL, 0, out, sizeof out},
        {"encode: no room", CANSER_OK, protocol, frames, 2, NULL, 0},
    };
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        now.part = calls[i].what;
        result = (canser_encoded){SIZE_MAX, SIZE_MAX, -1};
        check(canser_encode(calls[i].protocol, 1000, calls[i].frames, calls[i].frame_count,
                            calls[i].out, calls[i].out_cap, &result) == calls[i].status,
              "another status");
        check(result.frame_count == 0 && result.byte_count == 0 &&
                  result.refusal == CANSER_REFUSAL_NONE,
              "the results are not set");
        check(is_filled(out, sizeof out, UNUSED_BYTE), "out was written");
    }
    now.part = "encode: tick below 1";
    for (int64_t tick_ns = -1; tick_ns < 1; tick_ns++) {
        result = (canser_encoded){SIZE_MAX, SIZE_MAX, -1};
        check(canser_encode(protocol, tick_ns, frames, 2, out, sizeof out, &result) == CANSER_TICK,
              "another status");
        check(result.frame_count == 0 && result.byte_count == 0 &&
                  result.refusal == CANSER_REFUSAL_NONE,
              "the results are not set");
        check(is_filled(out, sizeof out, UNUSED_BYTE), "out was written");
    }
    now.part = "encode: result NULL";
    check(canser_encode(protocol, 1000, frames, 2, out, sizeof out, NULL) == CANSER_NULL,
          "another status");
    check(is_filled(out, sizeof out, UNUSED_BYTE), "out was written");

    now.part = "encode: out that touches";
    check(canser_encode(protocol, 1000, frames, 2, behind(frames, 48), 20, &result) == CANSER_OK,
          "another status");
}

static void check_refuse_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    canser_frame frames[3];
    uint8_t refusals[3];

    memset(refusals, UNUSED_BYTE, sizeof refusals);
    for (size_t i = 0; i < 2; i++)
        frames[i] = random_frame(now.protocol);

    const struct {
        const char *what;
        int status;
        const canser_protocol *protocol;
        const canser_frame *frames;
        size_t frame_count;
        uint8_t *refusals;
    } calls[] = {
        {"refuse: protocol NULL", CANSER_NULL, NULL, frames, 2, refusals},
        {"refuse: frames NULL", CANSER_NULL, protocol, NULL, 1, refusals},
        {"refuse: refusals NULL", CANSER_NULL, protocol, frames, 2, NULL},
        {"refuse: misaligned", CANSER_MISALIGNED, protocol, behind(frames, 1), 2, refusals},
        {"refuse: refusals on frames", CANSER_OVERLAP, protocol, frames, 2, behind(frames, 47)},
        {"refuse: no frames", CANSER_OK, protocol, NULL, 0, NULL},
    };
    for (size_t i = 0; i < sizeof calls / sizeof *calls; i++) {
        now.part = calls[i].what;
        check(canser_refuse(calls[i].protocol, calls[i].frames, calls[i].frame_count,
                            calls[i].refusals) == calls[i].status,
              "another status");
        check(is_filled(refusals, sizeof refusals, UNUSED_BYTE), "refusals was written");
    }
}

void test_encode_arguments(void)
{
    begin_part("encode: arguments");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++)
        check_encode_arguments();
}

void test_refuse_arguments(void)
{
    begin_part("refuse: arguments");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++)
        check_refuse_arguments();
}
