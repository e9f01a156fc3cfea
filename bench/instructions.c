/* The work whose instructions instructions.py counts, once.
 *
 *     instructions PROTOCOL decode|encode FILE
 *
 * Decodes the bytes of the file; for `encode`, encodes the frames found, and says if
 * they come out as other bytes. Prints the number of frames.
 */
#include "canser.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { TICK_NS = 1000000 };

/* What is counted is what these two do, by their names; so they must be functions. */
#if defined(__GNUC__)
#define NOINLINE __attribute__((noinline))
#else
#define NOINLINE
#endif

int measured_decode(canser_decoder *decoder, const uint8_t *data, size_t data_len,
                    canser_batch *batch, canser_batch *rest);
int measured_encode(const canser_protocol *protocol, const canser_frame *frames, size_t frame_count,
                    uint8_t *out, size_t out_cap, canser_encoded *result);

NOINLINE int measured_decode(canser_decoder *decoder, const uint8_t *data, size_t data_len,
                             canser_batch *batch, canser_batch *rest)
{
    size_t used;
    const int fed = canser_decoder_feed(decoder, data, data_len, batch, &used);
    const int flushed = canser_decoder_flush(decoder, rest);
    return fed == CANSER_OK && flushed == CANSER_OK && used == data_len && !decoder->carry_len;
}

NOINLINE int measured_encode(const canser_protocol *protocol, const canser_frame *frames,
                             size_t frame_count, uint8_t *out, size_t out_cap,
                             canser_encoded *result)
{
    const int status = canser_encode(protocol, TICK_NS, frames, frame_count, out, out_cap, result);
    return status == CANSER_OK && result->frame_count == frame_count;
}

static int fail(const char *what)
{
    fprintf(stderr, "instructions: %s\n", what);
    return 1;
}

static const canser_protocol *find_protocol(const char *name)
{
    const canser_protocol *row;
    for (size_t i = 0; (row = canser_protocol_at(i)) != NULL; i++)
        if (strcmp(row->name, name) == 0)
            return row;
    return NULL;
}

/* The bytes of a file, in memory that the caller frees; NULL if it cannot be read. */
static uint8_t *read_file(const char *path, size_t *len)
{
    FILE *const file = fopen(path, "rb");
    uint8_t *data = NULL;
    long size;

    if (!file)
        return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (size = ftell(file)) >= 0) {
        rewind(file);
        *len = (size_t)size;
        data = malloc(*len + 1);
        if (data && fread(data, 1, *len, file) != *len) {
            free(data);
            data = NULL;
        }
    }
    fclose(file);
    return data;
}

static int run(const canser_protocol *protocol, int encodes, const uint8_t *data, size_t data_len)
{
    const size_t cap = data_len / protocol->frame_min + 2;
    const size_t out_cap = cap * protocol->frame_max;
    canser_frame *const frames = calloc(cap, sizeof *frames);
    uint8_t *const out = calloc(out_cap, 1);
    canser_frame last[CANSER_PACKET_MAX];
    canser_batch batch = {.frames = frames, .frame_cap = cap};
    canser_batch rest = {.frames = last, .frame_cap = CANSER_PACKET_MAX};
    canser_decoder decoder;
    canser_encoded encoded;
    const char *wrong = NULL;

    if (!frames || !out)
        wrong = "no memory";
    else if (canser_decoder_init(&decoder, protocol, TICK_NS) != CANSER_OK ||
             !measured_decode(&decoder, data, data_len, &batch, &rest))
        wrong = "decoding fails";
    else if (encodes &&
             (!measured_encode(protocol, frames, batch.frame_count, out, out_cap, &encoded) ||
              encoded.byte_count != data_len || memcmp(out, data, data_len) != 0))
        wrong = "encoding gives other bytes";
    else
        printf("%zu\n", batch.frame_count + rest.frame_count);
    free(frames);
    free(out);
    return wrong ? fail(wrong) : 0;
}

int main(int argc, char **argv)
{
    const canser_protocol *const protocol = argc == 4 ? find_protocol(argv[1]) : NULL;
    const int decodes = protocol && strcmp(argv[2], "decode") == 0;
    const int encodes = protocol && strcmp(argv[2], "encode") == 0;
    size_t data_len = 0;

    if (!decodes && !encodes)
        return fail("needs PROTOCOL decode|encode FILE");
    uint8_t *const data = read_file(argv[3], &data_len);
    if (!data)
        return fail("the file cannot be read");
    const int status = run(protocol, encodes, data, data_len);
    free(data);
    return status;
}
