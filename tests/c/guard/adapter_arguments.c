/* The caller's mistakes in calls of canser_configure() and canser_explain(). */
#include "arena.h"
#include "checks.h"
#include "plain.h"
#include "tests.h"

#include <string.h>

static void check_adapter_arguments(void)
{
    const canser_protocol *const protocol = canser_protocol_at((size_t)now.protocol);
    const canser_config config = {.bitrate = 500000};
    const uint8_t byte = 0xFF;
    canser_packet packet;
    canser_report report;

    now.part = "configure: NULL";
    memset(&packet, UNUSED_BYTE, sizeof packet);
    check(canser_configure(NULL, &config, &packet) == CANSER_NULL, "another status");
    check(is_filled(&packet, sizeof packet, 0), "the packet is not set");
    memset(&packet, UNUSED_BYTE, sizeof packet);
    check(canser_configure(protocol, NULL, &packet) == CANSER_NULL, "another status");
    check(is_filled(&packet, sizeof packet, 0), "the packet is not set");
    check(canser_configure(protocol, &config, NULL) == CANSER_NULL, "another status");

    now.part = "explain: NULL";
    memset(&report, UNUSED_BYTE, sizeof report);
    check(canser_explain(NULL, &byte, 1, &report) == CANSER_NULL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
    memset(&report, UNUSED_BYTE, sizeof report);
    check(canser_explain(protocol, NULL, 1, &report) == CANSER_NULL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
    check(canser_explain(protocol, &byte, 1, NULL) == CANSER_NULL, "another status");

    now.part = "explain: no bytes";
    memset(&report, UNUSED_BYTE, sizeof report);
    check(canser_explain(protocol, NULL, 0, &report) == CANSER_NO_CONTROL, "another status");
    check(is_filled(&report, sizeof report, 0), "the report is not set");
}

void test_adapter_arguments(void)
{
    begin_part("adapter: arguments");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++)
        check_adapter_arguments();
}
