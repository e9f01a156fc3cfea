/* The lengths of frames on the bus, in bits.
 *
 *     standard   SOF  id 11        RTR  IDE  r0  dlc 4  data  CRC 15 | 1 ACK 1 EOF 7 pause 3
 *     extended   SOF  id 11  SRR IDE  id 18  RTR  r1  r0  dlc 4  data  CRC 15 | 1 1 1 7 3
 *
 * Up to the bar, a stuff bit of the other value follows five equal bits, and counts as the first of
 * the next ones. One may follow the last bit of the CRC, too.
 *
 * The CRC is linear, and begins with 0. So it is the sum of those of the message's bytes, each with
 * zero bytes behind it, and zero bits in front of the message change nothing. The bits of a frame
 * are a whole number of bytes but for the first ones: 2 of a standard frame, 6 of an extended one.
 * The stuff bits of a byte depend on the state in front of it: the value of the last bit, and how
 * many equal ones there are. This chain from byte to byte takes the most time, so several frames
 * go along together.
 *
 * Source: CAN 2.0 (Bosch, 1991), 3.1.1 data frame, 3.1.2 remote frame, 5 coding. */
#include "protocol.h"

/* Bits behind the CRC: its delimiter, ACK, its delimiter, EOF, the pause. */
enum { TAIL_BITS = 1 + 1 + 1 + 7 + 3 };

/* Bits with stuff bits among them, without the data. */
enum { STANDARD_BITS = 34, EXTENDED_BITS = 54 };

/* Bits of the header that are in front of whole bytes. */
enum { STANDARD_START = 2, EXTENDED_START = 6 };

enum { CRC_POLYNOMIAL = 0x4599, CRC_BITS = 15 };

/* Frames that go along together: each step waits for a load of 5 clock cycles, in which a processor
 * can begin several others. */
enum { LANES = 4 };

/* The most bytes of a frame's bits: 6 of an extended one, and its data. */
enum { BYTES_MAX = 14 };

static uint16_t add_to_crc(uint16_t crc, unsigned bit)
{
    const unsigned next = (crc >> (CRC_BITS - 1) & 1) ^ bit;

    return (uint16_t)((crc << 1 & 0x7FFF) ^ (next ? CRC_POLYNOMIAL : 0));
}

/* A state is 2 * (number of equal bits - 1) + their value. */
static unsigned add_to_stuff(unsigned entry, unsigned bit)
{
    unsigned run = (entry >> 8) / 2 + 1, value = (entry >> 8) & 1, count = entry & 0xFF;

    run = bit == value ? run + 1 : 1;
    value = bit;
    if (run == 5) {
        run = 1;
        value = !bit;
        count++;
    }
    return (2 * (run - 1) + value) << 8 | count;
}

int canser_bits_init(canser_bits *self)
{
    if (!self)
        return CANSER_NULL;
    for (unsigned byte = 0; byte < 256; byte++) {
        uint16_t crc = 0;
        for (int bit = 7; bit >= 0; bit--)
            crc = add_to_crc(crc, byte >> bit & 1);
        for (size_t behind = 0; behind < 13; behind++) {
            self->crc[behind][byte] = crc;
            for (int bit = 0; bit < 8; bit++)
                crc = add_to_crc(crc, 0);
        }
        for (unsigned state = 0; state < 10; state++) {
            unsigned entry = state << 8;
            for (int bit = 7; bit >= 0; bit--)
                entry = add_to_stuff(entry, byte >> bit & 1);
            self->stuff[state * 256 + byte] = (uint16_t)entry;
        }
    }
    for (unsigned bits = 0; bits < 32; bits++) {
        /* The state behind SOF, which is a single 0, is 0. */
        unsigned standard = add_to_stuff(0, bits & 1), extended = 0;
        for (int bit = 4; bit >= 0; bit--)
            extended = add_to_stuff(extended, bits >> bit & 1);
        self->start[0][bits] = (uint16_t)standard;
        self->start[1][bits] = (uint16_t)extended;
    }
    return CANSER_OK;
}

CANSER_INLINE uint64_t big_endian(const uint8_t *p)
{
    uint64_t value = 0;

    for (int i = 0; i < 8; i++)
        value = value << 8 | p[i];
    return value;
}

CANSER_INLINE void put_big_endian(uint8_t *p, uint64_t value)
{
    for (int i = 0; i < 8; i++)
        p[i] = (uint8_t)(value >> (56 - 8 * i));
}

/* Shifts of 64 bits by 0..64 bits. */
CANSER_INLINE uint64_t shift_left(uint64_t value, unsigned by)
{
    return by < 64 ? value << by : 0;
}

CANSER_INLINE uint64_t shift_right(uint64_t value, unsigned by)
{
    return by < 64 ? value >> by : 0;
}

/* A frame on its way along the stuff bits. */
typedef struct {
    uint8_t bytes[16]; /* behind the first bits */
    unsigned len;      /* how many of them count */
    unsigned state;    /* times 256 */
    unsigned sum;      /* the lowest byte is the number of stuff bits so far */
    unsigned bits;     /* all others */
} lane;

CANSER_INLINE uint64_t crc_of(const canser_bits *self, uint64_t high, uint64_t low)
{
    unsigned crc = 0;

    for (unsigned i = 0; i < 8; i++)
        crc ^= self->crc[i][low >> 8 * i & 0xFF];
    for (unsigned i = 0; i < 5; i++)
        crc ^= self->crc[8 + i][high >> 8 * i & 0xFF];
    return crc;
}

CANSER_INLINE void begin(const canser_bits *self, const canser_frame *frame, lane *to)
{
    const bool ext = frame->ext;
    const unsigned data_len = frame->rtr ? 0 : frame->dlc < DLC_MAX ? frame->dlc : DLC_MAX;
    const unsigned data_bits = 8 * data_len, free_bits = 64 - data_bits;
    /* The data, first byte highest, without what is behind them. */
    const uint64_t data = shift_left(shift_right(big_endian(frame->data), free_bits), free_bits);
    const uint64_t control = (uint64_t)(frame->rtr != 0) << 6 | (frame->dlc & 15);
    const uint64_t id = frame->id;
    /* SRR and IDE are 1 in an extended frame; RTR, IDE and r0 of a standard one need no shift. */
    const uint64_t header =
        ext ? (id >> 18 & 0x7FF) << 27 | UINT64_C(3) << 25 | (id & 0x3FFFF) << 7 | control
            : (id & 0x7FF) << 7 | control;
    /* Header bits behind the first ones: 17 or 33. */
    const unsigned header_bits = ext ? 39 - EXTENDED_START : 19 - STANDARD_START;
    const uint64_t crc = crc_of(self, shift_right(header, free_bits),
                                shift_left(header, data_bits) | shift_right(data, free_bits));
    const unsigned end = header_bits + data_bits + CRC_BITS; /* behind the CRC */
    const unsigned start = self->start[ext][ext ? header >> 33 & 31 : header >> 17 & 1];
    uint64_t first = header << (64 - header_bits) | data >> header_bits;
    uint64_t second = data << (64 - header_bits);

    first |= end <= 64 ? crc << (64 - end) : crc >> (end - 64);
    second |= end <= 64 ? 0 : crc << (128 - end);
    put_big_endian(to->bytes, first);
    put_big_endian(to->bytes + 8, second);
    to->len = end / 8;
    to->state = start & 0xF00;
    to->sum = start & 0xFF;
    to->bits = (ext ? EXTENDED_BITS : STANDARD_BITS) + data_bits + TAIL_BITS;
}

CANSER_INLINE void count(const canser_bits *self, const canser_frame *frames, size_t frame_count,
                         uint8_t *bits)
{
    lane lanes[LANES];
    unsigned longest = 0;

    for (size_t i = 0; i < frame_count; i++) {
        begin(self, &frames[i], &lanes[i]);
        longest = lanes[i].len > longest ? lanes[i].len : longest;
    }
    for (unsigned at = 0; at < longest; at++)
        for (size_t i = 0; i < frame_count; i++) {
            const unsigned entry = self->stuff[lanes[i].state | lanes[i].bytes[at]];
            lanes[i].state = entry & 0xF00;
            lanes[i].sum += at < lanes[i].len ? entry & 0xFF : 0;
        }
    for (size_t i = 0; i < frame_count; i++)
        bits[i] = frames[i].err ? 0 : (uint8_t)(lanes[i].bits + lanes[i].sum);
}

int canser_frame_bits(const canser_bits *self, const canser_frame *frames, size_t frame_count,
                      uint8_t *bits)
{
    size_t i = 0;

    if (!self || ((!frames || !bits) && frame_count))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    for (; frame_count - i >= LANES; i += LANES)
        count(self, frames + i, LANES, bits + i);
    for (; i < frame_count; i++)
        count(self, frames + i, 1, bits + i);
    return CANSER_OK;
}
