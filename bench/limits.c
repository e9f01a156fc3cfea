/* What bounds decoding: the times of its parts, in nanoseconds a frame.
 *
 *     limits PROTOCOL FILE
 *
 * Prints the chain alone (load what tells the length, add, load again: no more is done
 * with a frame), decoding of the first 64 KiB, which a cache holds, decoding of all,
 * decoding of all in pieces of 4 KiB, and the time of one cycle of additions. The least
 * of many rounds each.
 */
#define _POSIX_C_SOURCE 199309L

#include "canser.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { CACHED = 1 << 16, PIECE = 4096, ADDITIONS = 1000000 };

typedef size_t (*chain_fn)(const uint8_t *p, const uint8_t *end);

static double now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e9 + (double)t.tv_nsec;
}

/* The sums in the order in which the decoder has them, the load as early as there. */
#define OPAQUE(x) __asm__("" : "+r"(x))

static size_t chain_serial(const uint8_t *p, const uint8_t *end)
{
    size_t count = 0;
    for (; p < end; count++) {
        const uint8_t *next = p + 11;
        OPAQUE(next);
        p = next + p[5];
    }
    return count;
}

static size_t chain_seeed(const uint8_t *p, const uint8_t *end)
{
    size_t count = 0, lead = p[1];
    for (; p < end; count++) {
        const size_t more = lead >> 4; /* the mark 1100 and, of an extended id, 2 */
        const uint8_t *ahead = (const uint8_t *)((uintptr_t)p - 6 + (lead & 0xF));
        OPAQUE(ahead);
        lead = ahead[more];
        OPAQUE(ahead);
        p = ahead + more - 1;
    }
    return count;
}

static size_t chain_cantalope(const uint8_t *p, const uint8_t *end)
{
    size_t count = 0, lead = p[1];
    for (; p < end; count++) {
        const uint8_t *ahead = p + 3;
        const size_t dlc = lead & 0x1F;
        OPAQUE(ahead);
        lead = ahead[dlc];
        OPAQUE(ahead);
        p = ahead + dlc - 1;
    }
    return count;
}

static double least(double a, double b)
{
    return a < b ? a : b;
}

int main(int argc, char **argv)
{
    const struct {
        const char *name;
        chain_fn chain;
    } chains[] = {{"serial", chain_serial}, {"seeed", chain_seeed}, {"cantalope", chain_cantalope}};
    const canser_protocol *protocol = NULL;
    chain_fn chain = NULL;

    for (size_t i = 0; argc == 3 && canser_protocol_at(i); i++)
        if (strcmp(canser_protocol_at(i)->name, argv[1]) == 0)
            protocol = canser_protocol_at(i);
    for (size_t i = 0; argc == 3 && i < sizeof chains / sizeof *chains; i++)
        if (strcmp(chains[i].name, argv[1]) == 0)
            chain = chains[i].chain;
    FILE *const file = argc == 3 ? fopen(argv[2], "rb") : NULL;
    if (!protocol || !chain || !file) {
        fprintf(stderr, "limits: needs PROTOCOL FILE\n");
        return 1;
    }
    fseek(file, 0, SEEK_END);
    const size_t len = (size_t)ftell(file);
    const size_t cap = len / protocol->frame_min + 2;
    uint8_t *const data = malloc(len);
    canser_frame *const frames = malloc(cap * sizeof *frames);
    rewind(file);
    if (len < CACHED || !data || !frames || fread(data, 1, len, file) != len) {
        fprintf(stderr, "limits: the file is too short, or there is no memory\n");
        return 1;
    }
    fclose(file);
    memset(frames, 0, cap * sizeof *frames);

    double walk = 1e30, cached = 1e30, whole = 1e30, pieces = 1e30, cycle = 1e30;
    volatile size_t sink;
    for (int round = 0; round < 2000; round++) {
        canser_decoder decoder;
        canser_batch batch = {.frames = frames, .frame_cap = cap};
        size_t used;
        double start = now_ns();
        const size_t count = chain(data, data + CACHED - CANSER_BEHIND);
        walk = least(walk, (now_ns() - start) / (double)count);
        sink = count;

        canser_decoder_init(&decoder, protocol, 1000000);
        start = now_ns();
        canser_decoder_feed(&decoder, data, CACHED, &batch, &used);
        cached = least(cached, (now_ns() - start) / (double)batch.frame_count);
    }
    for (int round = 0; round < 15; round++) {
        canser_decoder decoder;
        canser_batch batch = {.frames = frames, .frame_cap = cap};
        size_t used;
        canser_decoder_init(&decoder, protocol, 1000000);
        double start = now_ns();
        canser_decoder_feed(&decoder, data, len, &batch, &used);
        const double count = (double)batch.frame_count;
        whole = least(whole, (now_ns() - start) / count);

        canser_decoder_init(&decoder, protocol, 1000000);
        canser_batch rest = {.frames = frames, .frame_cap = cap};
        start = now_ns();
        for (size_t at = 0; at < len; at += PIECE) {
            canser_decoder_feed(&decoder, data + at, len - at < PIECE ? len - at : PIECE, &rest,
                                &used);
            rest.frames += rest.frame_count;
            rest.frame_cap -= rest.frame_count;
        }
        pieces = least(pieces, (now_ns() - start) / count);

        size_t x = 1;
        start = now_ns();
        for (int i = 0; i < ADDITIONS; i++) {
            OPAQUE(x);
            x += (size_t)round | 1;
        }
        cycle = least(cycle, (now_ns() - start) / (double)ADDITIONS);
        sink = x;
    }
    (void)sink;
    printf("%.3f %.3f %.3f %.3f %.3f\n", walk, cached, whole, pieces, cycle);
    free(data);
    free(frames);
    return 0;
}
