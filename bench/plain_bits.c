/* The lengths of frames on the bus by the plain loop of the tests, for bus_numbers.py. */
#include "../tests/c/plain_bits.h"

void plain_lengths(const canser_frame *frames, size_t frame_count, uint8_t *bits);

void plain_lengths(const canser_frame *frames, size_t frame_count, uint8_t *bits)
{
    for (size_t i = 0; i < frame_count; i++)
        bits[i] = (uint8_t)plain_length(&frames[i]);
}
