/* The names and the numbers that the header promises: rows of protocols, texts for every number. */
#include "checks.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

void test_tables(void)
{
    begin_part("tables");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        const canser_protocol *const p = canser_protocol_at((size_t)now.protocol);
        const plain_format *const format = plain_format_of(now.protocol);
        size_t len_min = SIZE_MAX, len_max = 0;

        check(p && strcmp(p->name, format->name) == 0, "another name");
        check(p && p->has_clock == format->has_clock, "has_clock");
        for (int i = 0; i < 10000; i++) {
            const canser_frame f = random_frame(now.protocol);
            uint8_t packet[CANSER_PACKET_MAX];
            int refusal;
            const size_t len = plain_encode(now.protocol, 1, &f, packet, &refusal);
            len_min = len < len_min ? len : len_min;
            len_max = len > len_max ? len : len_max;
        }
        check(p && p->frame_min == len_min, "frame_min");
        check(p && p->frame_max == len_max, "frame_max");
        check(p && p->baudrate == format->baudrate, "baudrate");
        check(p && (p->bitrates != NULL) == format->has_bitrates, "bitrates");
    }
    check(!canser_protocol_at(PLAIN_PROTOCOL_COUNT) && !canser_protocol_at(SIZE_MAX),
          "there is a protocol past the last");
    now.protocol = 0;

    for (int i = 0; i < CANSER_REJECT_COUNT; i++) {
        const char *const name = canser_reject_name(i);
        check(name && *name && strspn(name, "abcdefghijklmnopqrstuvwxyz") == strlen(name),
              "the name of a reject is not one lower-case word");
    }
    check(!canser_reject_name(-1) && !canser_reject_name(CANSER_REJECT_COUNT),
          "there is a reject past the last");
    for (int i = 0; i < CANSER_REFUSAL_COUNT; i++)
        check(canser_refusal_text(i), "a refusal has no text");
    check(!canser_refusal_text(-1) && !canser_refusal_text(CANSER_REFUSAL_COUNT),
          "there is a refusal past the last");
    for (int i = 0; i < CANSER_REFUSAL_COUNT; i++)
        check(canser_refusal_name(i), "a refusal has no name");
    check(!canser_refusal_name(-1) && !canser_refusal_name(CANSER_REFUSAL_COUNT),
          "there is a refusal past the last");
    for (int i = 0; i < CANSER_MODE_COUNT; i++)
        check(canser_mode_name(i), "a mode has no name");
    check(!canser_mode_name(-1) && !canser_mode_name(CANSER_MODE_COUNT),
          "there is a mode past the last");
    for (int i = 0; i < CANSER_CONTROL_COUNT; i++)
        check(canser_control_name(i), "a kind of control packets has no name");
    check(!canser_control_name(-1) && !canser_control_name(CANSER_CONTROL_COUNT),
          "there is a kind of control packets past the last");
}
