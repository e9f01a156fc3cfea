/* The length of a frame on the bus, bit by bit: from the tables and figures of CAN 2.0. */
#ifndef PLAIN_BITS_H
#define PLAIN_BITS_H

#include "canser.h"

/* Append the lowest bits of a number, the highest one first. */
static unsigned put(uint8_t *bits, unsigned count, uint32_t value, int number)
{
    for (int i = number - 1; i >= 0; i--)
        bits[count++] = (uint8_t)(value >> i & 1);
    return count;
}

/* As canser_frame_bits(). */
static unsigned plain_length(const canser_frame *frame)
{
    uint8_t bits[128];
    unsigned count = put(bits, 0, 0, 1), crc = 0, equal = 0, last = 2, stuffed;

    if (frame->err)
        return 0;
    count = put(bits, count, frame->ext ? frame->id >> 18 : frame->id, 11);
    if (frame->ext) {
        count = put(bits, count, 3, 2);
        count = put(bits, count, frame->id, 18);
    }
    count = put(bits, count, frame->rtr, 1);
    count = put(bits, count, 0, 2);
    count = put(bits, count, frame->dlc, 4);
    for (unsigned i = 0; i < frame->dlc && i < 8 && !frame->rtr; i++)
        count = put(bits, count, frame->data[i], 8);
    for (unsigned i = 0; i < count; i++) {
        const unsigned next = bits[i] ^ (crc >> 14 & 1);
        crc = (crc << 1 & 0x7FFF) ^ (next ? 0x4599 : 0);
    }
    stuffed = count = put(bits, count, crc, 15);
    for (unsigned i = 0; i < count; i++) {
        equal = bits[i] == last ? equal + 1 : 1;
        last = bits[i];
        if (equal == 5) {
            stuffed++;
            equal = 1;
            last = !last;
        }
    }
    return stuffed + 1 + 2 + 7 + 3;
}

#endif
