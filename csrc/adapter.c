/* Packets of an adapter besides frames: its configuration, and the meaning of its control
 * packets. The wire formats define the bytes. */
#include "protocol.h"

const char *canser_mode_name(int mode)
{
    static const char *const names[CANSER_MODE_COUNT] = {
        [CANSER_MODE_NORMAL] = "normal",
        [CANSER_MODE_LOOPBACK] = "loopback",
        [CANSER_MODE_SILENT] = "silent",
        [CANSER_MODE_LOOPBACK_SILENT] = "loopback-silent",
    };
    return mode >= 0 && mode < CANSER_MODE_COUNT ? names[mode] : NULL;
}

const char *canser_control_name(int kind)
{
    static const char *const names[CANSER_CONTROL_COUNT] = {
        [CANSER_CONTROL_OTHER] = "other",
        [CANSER_CONTROL_PING] = "ping",
        [CANSER_CONTROL_STATUS] = "status",
        [CANSER_CONTROL_ERROR] = "error",
        [CANSER_CONTROL_CONFIGURATION] = "configuration",
    };
    return kind >= 0 && kind < CANSER_CONTROL_COUNT ? names[kind] : NULL;
}

int canser_configure(const canser_protocol *protocol, const canser_config *config,
                     canser_packet *packet)
{
    if (!packet)
        return CANSER_NULL;
    memset(packet, 0, sizeof *packet);
    if (!protocol || !config)
        return CANSER_NULL;
    const uint32_t *const bitrates = protocol->bitrates;
    if (!bitrates)
        return CANSER_UNABLE;

    size_t rate = 0;
    while (bitrates[rate] && bitrates[rate] != config->bitrate)
        rate++;
    /* A filter with bits that no id has is a mistake, though the packet has room for them. */
    if (!bitrates[rate] || config->mode >= CANSER_MODE_COUNT || config->filter_id > ID_EXT_MAX ||
        config->filter_mask > ID_EXT_MAX)
        return CANSER_RANGE;
    protocol->codec->configure(config, rate, packet);
    return CANSER_OK;
}

int canser_explain(const canser_protocol *protocol, const uint8_t *packet, size_t len,
                   canser_report *report)
{
    if (!report)
        return CANSER_NULL;
    memset(report, 0, sizeof *report);
    if (!protocol || (!packet && len))
        return CANSER_NULL;

    /* The decoder decides whether the bytes are a packet, as everywhere. */
    canser_frame frame;
    canser_control control;
    canser_batch batch = {.frames = &frame, .frame_cap = 1, .controls = &control, .control_cap = 1};
    canser_decoder decoder;
    size_t used;

    if (len > CANSER_PACKET_MAX)
        return CANSER_NO_CONTROL;
    canser_decoder_init(&decoder, protocol, 1);
    canser_decoder_feed(&decoder, packet, len, &batch, &used);
    if (decoder.stats.bytes_control != len || batch.control_count != 1)
        return CANSER_NO_CONTROL;
    protocol->codec->explain(control.bytes, report);
    return CANSER_OK;
}
