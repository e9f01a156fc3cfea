/* One stream at a time: a decoder that is driven over it, and what plain.c finds in it. */
#ifndef STREAMS_H
#define STREAMS_H

#include "drive.h"

enum {
    LEN_MAX = 160,            /* the longest stream: some windows, and a page holds its rows */
    ROW_CAP = LEN_MAX / 2 + 2 /* no packet is shorter than 2 bytes */
};

extern drive driven;
extern plain_stream open_stream;  /* the bytes, and more may come */
extern plain_stream ended_stream; /* the bytes, and nothing behind them */

void set_up_streams(void);

/* Find what is in a stream of now.protocol, whole, by plain.c. */
void expect_streams(const uint8_t *stream, size_t len, int64_t tick_ns);

#endif
