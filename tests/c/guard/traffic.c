#include "traffic.h"
#include "chance.h"

#include <string.h>

canser_frame random_frame(int protocol)
{
    static const int64_t units[] = {1, 1000, 1000000, 1000000000};
    canser_frame f;

    memset(&f, 0, sizeof f);
    f.ext = plain_format_of(protocol)->has_ext && random_below(2);
    f.id = (uint32_t)random_word() & (f.ext ? 0x1FFFFFFF : 0x7FF);
    if (random_below(8) == 0)
        f.id = f.ext ? 0x1FFFFFFF : 0x7FF;
    f.rtr = random_below(4) == 0;
    f.err = plain_format_of(protocol)->has_err && random_below(8) == 0;
    f.dlc = (uint8_t)random_below(9);
    /* All eight, whatever the dlc: what lies behind it must not go out. */
    for (int i = 0; i < 8; i++)
        f.data[i] = (uint8_t)random_word();
    f.ts = (int64_t)(random_word() % 0x200000000) * units[random_below(4)] - 0x80000000;
    return f;
}

bool spoil(int protocol, int refusal, canser_frame *f)
{
    switch (refusal) {
    case CANSER_REFUSAL_DLC:
        f->dlc = (uint8_t)(9 + random_below(247));
        return true;
    case CANSER_REFUSAL_ID:
        f->ext = 0;
        f->id = 0x800 + (uint32_t)random_below(0x1000);
        return true;
    case CANSER_REFUSAL_ID_EXT:
        f->ext = 1;
        f->id = 0x20000000 + (uint32_t)random_below(0xE0000000);
        return plain_format_of(protocol)->has_ext;
    case CANSER_REFUSAL_EXT:
        f->ext = 1;
        return !plain_format_of(protocol)->has_ext;
    case CANSER_REFUSAL_ERR:
        f->err = 1;
        return !plain_format_of(protocol)->has_err;
    default:
        f->ts = CANSER_NO_TIME;
        return plain_format_of(protocol)->has_clock;
    }
}

/* A ping or an error. */
static size_t put_cantalope_control(uint8_t *out)
{
    out[0] = out[1] = 0xFF;
    out[2] = (uint8_t)random_below(2);
    out[3] = (uint8_t)random_word();
    return out[2] ? 4 : 3;
}

/* A packet of fixed length: the frame or, half the time, anything. */
static size_t put_seeed_fixed(const canser_frame *f, uint8_t *out)
{
    unsigned sum = 0;

    out[0] = 0xAA;
    out[1] = 0x55;
    for (int i = 2; i < 19; i++)
        out[i] = (uint8_t)random_word();
    if (random_below(2)) {
        out[2] = 0x01;
        out[3] = f->ext ? 2 : 1;
        out[4] = f->rtr ? 2 : 1;
        for (int i = 0; i < 4; i++)
            out[5 + i] = (uint8_t)(f->id >> 8 * i);
        out[9] = f->dlc;
    }
    for (int i = 2; i < 19; i++)
        sum += out[i];
    out[19] = (uint8_t)sum;
    return 20;
}

/* Now and then, a packet of a kind that no encoder makes. Returns its length, or 0 for none. */
static size_t put_other_kind(int protocol, const canser_frame *f, uint8_t *out)
{
    switch (protocol) {
    case PLAIN_cantalope:
        return random_below(6) ? 0 : put_cantalope_control(out);
    case PLAIN_seeed:
        return random_below(4) ? 0 : put_seeed_fixed(f, out);
    default:
        return 0;
    }
}

/* The other form of a remote frame of `len` bytes, where there is one. Returns its length. */
static size_t put_other_form(int protocol, const canser_frame *f, uint8_t *out, size_t len)
{
    switch (protocol) {
    case PLAIN_seeed: /* without filler */
        len -= 1 + (size_t)f->dlc;
        out[len++] = 0x55;
        return len;
    case PLAIN_serial: /* with filler */
        len--;
        for (int i = 0; i < f->dlc; i++)
            out[len++] = (uint8_t)random_word();
        out[len++] = 0xBB;
        return len;
    default:
        return len;
    }
}

size_t random_packet(int protocol, uint8_t out[CANSER_PACKET_MAX])
{
    const canser_frame f = random_frame(protocol);
    size_t len = put_other_kind(protocol, &f, out);
    int refusal;

    if (len)
        return len;
    len = plain_encode(protocol, 1000, &f, out, &refusal);
    return f.rtr && random_below(2) ? put_other_form(protocol, &f, out, len) : len;
}

void make_stream(int protocol, int kind, uint8_t *stream, size_t len)
{
    const char *const alphabet = plain_format_of(protocol)->alphabet;
    size_t pos = 0;

    while (pos < len) {
        uint8_t packet[CANSER_PACKET_MAX];
        size_t packet_len = 1;

        if (kind == KIND_HOSTILE) {
            packet[0] = (uint8_t)alphabet[random_below(8)];
        } else if (kind == KIND_MARKERS) {
            packet[0] = (uint8_t)alphabet[0];
        } else {
            packet_len = random_packet(protocol, packet);
        }
        if (kind == KIND_NOISY && random_below(3) == 0)
            packet[random_below(packet_len)] ^= (uint8_t)(1 << random_below(8));
        if (kind == KIND_NOISY && random_below(3) == 0)
            packet_len = 1 + random_below(packet_len);
        for (size_t i = 0; i < packet_len && pos < len; i++)
            stream[pos++] = packet[i];
        if (kind == KIND_NOISY && random_below(4) == 0 && pos < len)
            stream[pos++] = (uint8_t)alphabet[random_below(8)];
    }
}
