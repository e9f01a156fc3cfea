/* The lengths of frames on the bus, bit by bit: what bus_bits.py compares canser.frame_bits with.
 */
#include "../tests/c/plain_bits.h"

#include <stddef.h>

void plain_bits(const canser_frame *frames, size_t frame_count, uint8_t *bits);

void plain_bits(const canser_frame *frames, size_t frame_count, uint8_t *bits)
{
    for (size_t i = 0; i < frame_count; i++)
        bits[i] = (uint8_t)plain_length(&frames[i]);
}
