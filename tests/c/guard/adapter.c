/* What adapters understand besides frames: configurations, and what control packets mean, those of
 * a protocol's row too. No memory but the caller's is touched. */
#include "arena.h"
#include "chance.h"
#include "checks.h"
#include "streams.h"
#include "tests.h"
#include "traffic.h"

#include <string.h>

/* canser_explain, with all memory against guard pages. */
static int explain(const uint8_t *bytes, size_t len, canser_report *report)
{
    uint8_t *const input = place(DRIVE_INPUT, len);
    canser_report *const out = place(DRIVE_CONTROLS, sizeof *out);

    if (len)
        memcpy(input, bytes, len);
    const int status = canser_explain(canser_protocol_at((size_t)now.protocol), input, len, out);
    check(len == 0 || memcmp(input, bytes, len) == 0, "the packet was written");
    drop(DRIVE_INPUT, input, len);
    drop(DRIVE_CONTROLS, out, sizeof *out);
    *report = *out;
    return status;
}

/* Explained is what is one control packet, and nothing else is. */
static void check_explained(const uint8_t *bytes, size_t len)
{
    canser_report report;

    expect_streams(bytes, len, 1000);
    const bool is_control =
        open_stream.control_count == 1 && open_stream.stats.bytes_control == len;
    check(explain(bytes, len, &report) == (is_control ? CANSER_OK : CANSER_NO_CONTROL),
          "another status");
    check(is_control || is_filled(&report, sizeof report, 0), "the report is not set");

    int kind = CANSER_CONTROL_OTHER;
    if (is_control && now.protocol == PLAIN_cantalope)
        kind = bytes[2] == 0x00 ? CANSER_CONTROL_PING : CANSER_CONTROL_ERROR;
    else if (is_control && bytes[2] == 0x04)
        kind = CANSER_CONTROL_STATUS;
    else if (report.kind == CANSER_CONTROL_CONFIGURATION) /* test_configure says when */
        kind = report.kind;
    check(report.kind == kind, "another kind");
}

void test_explain(void)
{
    enum { TRIES = 400 };

    begin_part("explain");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (int side = 0; side < 2; side++) {
            now.at_end = side;
            for (int i = 0; i < TRIES; i++) {
                uint8_t bytes[2 * CANSER_PACKET_MAX + 1];
                size_t len = random_packet(now.protocol, bytes);

                check_explained(bytes, len);
                check_explained(bytes, len - 1);
                len += random_packet(now.protocol, bytes + len);
                check_explained(bytes, len);
            }
            for (now.kind = 0; now.kind < KIND_COUNT; now.kind++) {
                for (size_t len = 0; len <= CANSER_PACKET_MAX + 1; len++) {
                    uint8_t bytes[CANSER_PACKET_MAX + 1];

                    make_stream(now.protocol, now.kind, bytes, len);
                    check_explained(bytes, len);
                }
            }
        }
    }
}

/* A configuration of which any value may be out of range. */
static canser_config random_config(void)
{
    static const uint32_t rates[] = {1000000, 800000, 500000, 400000, 250000, 200000, 125000,
                                     100000,  50000,  20000,  10000,  5000,   0,      5001};
    static const uint32_t ids[] = {0, 0x123, 0x12345678, 0x1FFFFFFF, 0x20000000, UINT32_MAX};

    return (canser_config){
        .bitrate = rates[random_below(sizeof rates / sizeof *rates)],
        .filter_id = ids[random_below(sizeof ids / sizeof *ids)],
        .filter_mask = ids[random_below(sizeof ids / sizeof *ids)],
        .mode = (uint8_t)random_below(CANSER_MODE_COUNT + 1),
        .ext_only = (uint8_t)random_below(3),
        .once = (uint8_t)random_below(3),
        .fixed = (uint8_t)random_below(3),
    };
}

static int plain_configure_status(const canser_config *config)
{
    if (!plain_format_of(now.protocol)->has_bitrates)
        return CANSER_UNABLE;
    return config->bitrate < 5000 || config->bitrate == 5001 || config->filter_id > 0x1FFFFFFF ||
                   config->filter_mask > 0x1FFFFFFF || config->mode > 3
               ? CANSER_RANGE
               : CANSER_OK;
}

/* What is configured is what the packet, a control packet, says. */
static void check_configured(const canser_config *config)
{
    canser_config *const input = place(DRIVE_INPUT, sizeof *input);
    canser_packet *const out = place(DRIVE_CONTROLS, sizeof *out);
    canser_report report;

    *input = *config;
    const int expected = plain_configure_status(config);
    check(canser_configure(canser_protocol_at((size_t)now.protocol), input, out) == expected,
          "another status");
    const canser_packet packet = *out;
    drop(DRIVE_INPUT, input, sizeof *input);
    drop(DRIVE_CONTROLS, out, sizeof *out);
    if (expected) {
        check(is_filled(&packet, sizeof packet, 0), "there is a packet after an error");
        return;
    }
    check(packet.len == 20, "another length"); /* of seeed, which alone has bit rates */
    check_explained(packet.bytes, packet.len);
    check(explain(packet.bytes, packet.len, &report) == CANSER_OK, "no control packet");
    check(report.kind == CANSER_CONTROL_CONFIGURATION && report.receive_errors == 0 &&
              report.transmit_errors == 0 && report.number == 0,
          "no configuration");
    const canser_config *const told = &report.config;
    check(told->bitrate == config->bitrate && told->filter_id == config->filter_id &&
              told->filter_mask == config->filter_mask && told->mode == config->mode &&
              told->ext_only == (config->ext_only != 0) && told->once == (config->once != 0) &&
              told->fixed == (config->fixed != 0),
          "another configuration is told");
}

void test_configure(void)
{
    enum { TRIES = 2000 };

    begin_part("configure");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        for (int i = 0; i < TRIES; i++) {
            const canser_config config = random_config();

            now.at_end = i % 2;
            check_configured(&config);
        }
    }
}

/* The packets of a row are control packets, or none. */
static void check_row_packet(const canser_packet *packet, int protocol, int kind)
{
    canser_report report;

    now.len = packet->len;
    check((packet->len != 0) == (now.protocol == protocol), "a packet that is there, or is not");
    check(is_filled(packet->bytes + packet->len, sizeof packet->bytes - packet->len, 0),
          "padding is not zero");
    if (packet->len) {
        check(explain(packet->bytes, packet->len, &report) == CANSER_OK && report.kind == kind,
              "another kind of packet");
    }
}

void test_row_packets(void)
{
    begin_part("packets of a row");
    for (now.protocol = 0; now.protocol < PLAIN_PROTOCOL_COUNT; now.protocol++) {
        const canser_protocol *const p = canser_protocol_at((size_t)now.protocol);

        check_row_packet(&p->ping, PLAIN_cantalope, CANSER_CONTROL_PING);
        check_row_packet(&p->status_request, PLAIN_seeed, CANSER_CONTROL_STATUS);
    }
}
