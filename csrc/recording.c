/* Usual blocks of a recording: checks, and the bytes of the line gathered.
 *
 *     0  type 6, total length, interface, time high, time low,     7 words of 32 bits,
 *        captured length, original length                          little endian
 *    28  the bytes of the line, padded to a multiple of 4
 *        hash:    3 u16, 5 u16, 2 u8, CRC32 u32, 3 bytes of padding
 *        number:  5 u16, 8 u16, id u64; in old files: 4 u16, 8 u16, drop count u64
 *        end:     0 u16, 0 u16
 *        total length u32
 */
#include "protocol.h"

enum {
    HEAD_LEN = 28,
    TAIL_LEN = 12 + 12 + 4 + 4,
    ENHANCED = 6,
    LENGTH_MAX = 1 << 24, /* of a block: the limit of other readers */
    HASH = 3 | 5 << 16,   /* code and length of an option */
    ID = 5 | 8 << 16,
    DROP_COUNT = 4 | 8 << 16,
    CRC32 = 2 /* the hash's algorithm, its first byte */
};

/* The CRC32 of IEEE 802.3, of the hash: the polynomial with its bits reversed. */
#define POLYNOMIAL 0xEDB88320u

int canser_recording_init(canser_recording *self)
{
    if (!self)
        return CANSER_NULL;
    memset(self, 0, sizeof *self);
    for (uint32_t byte = 0; byte < 256; byte++) {
        uint32_t crc = byte;

        for (int bit = 0; bit < 8; bit++)
            crc = crc >> 1 ^ (crc & 1 ? POLYNOMIAL : 0);
        self->crc32s[0][byte] = crc;
    }
    for (int zeros = 1; zeros < 16; zeros++)
        for (int byte = 0; byte < 256; byte++) {
            const uint32_t before = self->crc32s[zeros - 1][byte];

            self->crc32s[zeros][byte] = before >> 8 ^ self->crc32s[0][before & 0xFF];
        }
    return CANSER_OK;
}

/* The CRC32 of the four bytes of a word with `zeros` zeros behind them. */
CANSER_INLINE uint32_t crc32_word(const canser_recording *self, uint32_t word, int zeros)
{
    return self->crc32s[zeros + 3][word & 0xFF] ^ self->crc32s[zeros + 2][word >> 8 & 0xFF] ^
           self->crc32s[zeros + 1][word >> 16 & 0xFF] ^ self->crc32s[zeros][word >> 24];
}

/* Continue a CRC32 by tables, 16 bytes at a time. */
static uint32_t crc32_tables(const canser_recording *self, uint32_t crc, const uint8_t *p,
                             size_t len)
{
    for (; len >= 16; p += 16, len -= 16)
        crc = crc32_word(self, load_le32(p) ^ crc, 12) ^ crc32_word(self, load_le32(p + 4), 8) ^
              crc32_word(self, load_le32(p + 8), 4) ^ crc32_word(self, load_le32(p + 12), 0);
    for (; len >= 4; p += 4, len -= 4)
        crc = crc32_word(self, load_le32(p) ^ crc, 0);
    for (; len; p++, len--)
        crc = crc >> 8 ^ self->crc32s[0][(crc ^ *p) & 0xFF];
    return crc;
}

/* Many bytes are first folded into the last FOLD_LEN of them, without tables.
 *
 * The polynomial divides x^300 + x^155 + x^117 + x^89 + 1, modulo 2. No multiple of fewer terms is
 * shorter than 3000 bits, and none of five terms is shorter than this one. Squaring modulo 2
 * doubles each exponent, so the same holds for bytes: a byte leaves the same remainder as four
 * copies of it, 145, 183, 211 and 300 bytes behind. So each byte is added at these places, and is
 * then done. As the nearest copy is 145 bytes away, compilers handle many bytes at a time. */
enum { FOLD_1 = 300 - 155, FOLD_2 = 300 - 117, FOLD_3 = 300 - 89, FOLD_LEN = 300 };

/* Bytes that are folded at a time: they fit into the nearest cache. */
enum { FOLD_STEP = 4096 };

/* The fewest bytes that are folded. With fewer, the end takes longer than the folding saves. */
enum { FOLD_MIN = 800 };

static uint32_t crc32_folded(const canser_recording *self, uint32_t crc, const uint8_t *p,
                             size_t len)
{
    uint8_t folded[FOLD_LEN + FOLD_STEP], last[FOLD_LEN];
    uint8_t *const now = folded + FOLD_LEN;
    const uint8_t *const end = p + len - FOLD_LEN;
    size_t i;

    memset(folded, 0, FOLD_LEN); /* there are no bytes before the first one */
    for (i = 0; i < 4; i++)
        now[i] = (uint8_t)(p[i] ^ crc >> 8 * i);
    while (p < end) {
        const size_t left = (size_t)(end - p), step = left < FOLD_STEP ? left : FOLD_STEP;

        for (; i < step; i++)
            folded[FOLD_LEN + i] =
                (uint8_t)(p[i] ^ folded[i] ^ folded[FOLD_LEN - FOLD_1 + i] ^
                          folded[FOLD_LEN - FOLD_2 + i] ^ folded[FOLD_LEN - FOLD_3 + i]);
        i = 0;
        memmove(folded, folded + step, FOLD_LEN);
        p += step;
    }
    for (i = 0; i < FOLD_LEN; i++)
        last[i] = p[i] ^ folded[i];
    for (i = 0; i < FOLD_1; i++)
        last[i] ^= folded[FOLD_LEN - FOLD_1 + i];
    for (i = 0; i < FOLD_2; i++)
        last[i] ^= folded[FOLD_LEN - FOLD_2 + i];
    for (i = 0; i < FOLD_3; i++)
        last[i] ^= folded[FOLD_LEN - FOLD_3 + i];
    return crc32_tables(self, 0, last, FOLD_LEN);
}

static uint32_t crc32_of(const canser_recording *self, const uint8_t *p, size_t len)
{
    return ~(len < FOLD_MIN ? crc32_tables(self, UINT32_MAX, p, len)
                            : crc32_folded(self, UINT32_MAX, p, len));
}

CANSER_INLINE uint64_t load_le64(const uint8_t *p)
{
    return load_le32(p) | (uint64_t)load_le32(p + 4) << 32;
}

/* Return the length of a usual block, and set that of its bytes; 0 if it is unusual. */
static size_t check_block(const canser_recording *self, uint64_t id, const uint8_t *p,
                          size_t readable, size_t *len)
{
    if (readable < HEAD_LEN + TAIL_LEN)
        return 0;
    *len = load_le32(p + 20);
    if (!*len || *len > LENGTH_MAX)
        return 0;
    const size_t padded = (*len + 3) / 4 * 4, total = HEAD_LEN + padded + TAIL_LEN;
    const uint8_t *const tail = p + HEAD_LEN + padded;

    if (total > LENGTH_MAX || total > readable || load_le32(p) != ENHANCED ||
        load_le32(p + 4) != total || load_le32(p + 8) != self->interface ||
        load_le32(p + 12) >> 31 || load_le32(tail) != HASH || tail[4] != CRC32 ||
        load_le32(tail + 12) != (self->has_ids ? ID : DROP_COUNT) ||
        load_le64(tail + 16) != (self->has_ids ? id : 0) || load_le32(tail + 24) ||
        load_le32(tail + 28) != total)
        return 0;
    return total;
}

int canser_recording_gather(canser_recording *self, const uint8_t *data, size_t data_len,
                            uint8_t *out, size_t out_cap, canser_piece *pieces, size_t piece_cap,
                            canser_gathered *result)
{
    if (!result)
        return CANSER_NULL;
    *result = (canser_gathered){0, 0, 0};
    if (!self || (!data && data_len) || (!out && out_cap) || (!pieces && piece_cap))
        return CANSER_NULL;
    if (misaligned(pieces, _Alignof(canser_piece)))
        return CANSER_MISALIGNED;
    const span in = span_of(data, data_len, 1), bytes = span_of(out, out_cap, 1),
               rows = span_of(pieces, piece_cap, sizeof *pieces);
    if (spans_meet(in, bytes) || spans_meet(in, rows) || spans_meet(bytes, rows))
        return CANSER_OVERLAP;

    size_t used = 0, byte_count = 0, piece_count = 0, len;
    while (piece_count < piece_cap && used < data_len) {
        const uint8_t *const p = data + used;
        const uint64_t id = self->next_id + byte_count;
        const size_t total = check_block(self, id, p, data_len - used, &len);

        if (!total || len > out_cap - byte_count ||
            crc32_of(self, p + HEAD_LEN, len) != load_le32(p + total - TAIL_LEN + 5))
            break;
        memcpy(out + byte_count, p + HEAD_LEN, len);
        byte_count += len;
        used += total;
        pieces[piece_count++] = (canser_piece){
            (int64_t)byte_count, (int64_t)((uint64_t)load_le32(p + 12) << 32 | load_le32(p + 16))};
    }
    self->next_id += byte_count;
    *result = (canser_gathered){used, byte_count, piece_count};
    return CANSER_OK;
}
