/* Decode a file of raw bytes with the C library alone: decode PROTOCOL FILE. */
#include "canser.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

static const canser_protocol *find(const char *name)
{
    const canser_protocol *protocol = NULL;

    for (size_t i = 0; (protocol = canser_protocol_at(i)) != NULL; i++)
        if (strcmp(protocol->name, name) == 0)
            break;
    return protocol;
}

static void print_frames(const canser_frame *frames, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        printf(frames[i].ext ? "%08" PRIX32 "#" : "%03" PRIX32 "#", frames[i].id);
        for (int k = 0; k < frames[i].dlc && !frames[i].rtr; k++)
            printf("%02X", frames[i].data[k]);
        puts(frames[i].rtr ? "R" : "");
    }
}

int main(int argc, char **argv)
{
    const canser_protocol *protocol = argc == 3 ? find(argv[1]) : NULL;
    FILE *file = protocol ? fopen(argv[2], "rb") : NULL;
    canser_decoder decoder;
    canser_frame frames[256];
    canser_batch batch = {.frames = frames, .frame_cap = sizeof frames / sizeof *frames};
    uint8_t data[4096];
    size_t len, used;

    if (!file) {
        fprintf(stderr, "usage: decode PROTOCOL FILE\n");
        return 2;
    }
    canser_decoder_init(&decoder, protocol, 1000000);
    while ((len = fread(data, 1, sizeof data, file)) > 0)
        for (size_t done = 0; done < len; done += used) {
            canser_decoder_feed(&decoder, data + done, len - done, &batch, &used);
            print_frames(frames, batch.frame_count);
        }
    do { /* the end: what is held is scanned */
        canser_decoder_flush(&decoder, &batch);
        print_frames(frames, batch.frame_count);
    } while (decoder.carry_len);
    fclose(file);
    fprintf(stderr, "%" PRIu64 " frames, %" PRIu64 " bytes skipped\n", decoder.stats.frames,
            decoder.stats.bytes_skipped);
    return 0;
}
