/* Private: what tells frames of different ids apart, as one number. */
#ifndef CANSER_KEYS_H
#define CANSER_KEYS_H

#include "protocol.h"

CANSER_INLINE uint64_t load(const void *p)
{
    uint64_t value;

    memcpy(&value, p, sizeof value);
    return value;
}

/* The bits of a frame's first 8 bytes that are in its key. */
CANSER_INLINE uint64_t key_mask(bool is_remote_apart)
{
    static const canser_frame apart = {.id = ID_EXT_MAX, .ext = 1, .rtr = 1, .err = 1};
    static const canser_frame together = {.id = ID_EXT_MAX, .ext = 1, .err = 1};

    return load(is_remote_apart ? &apart : &together);
}

/* The key: those bits, with the channel in the place of the dlc. */
CANSER_INLINE uint64_t make_key(const canser_frame *frame, uint64_t mask, uint8_t channel)
{
    const unsigned at = offsetof(canser_frame, dlc);

    /* The load of a value that was just stored in parts would wait. */
    return (load(frame) & mask) | (uint64_t)channel << 8 * (CANSER_BIG_ENDIAN ? 7 - at : at);
}

#endif
