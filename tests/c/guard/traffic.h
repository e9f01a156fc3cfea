/* Random traffic: frames, packets and streams of each protocol. What the tests know of a protocol
 * is in plain.c; the packets that no encoder makes are in traffic.c. */
#ifndef TRAFFIC_H
#define TRAFFIC_H

#include "plain.h"

/* Kinds of streams. */
enum {
    KIND_CLEAN,   /* packets, one behind the other */
    KIND_NOISY,   /* the same with bytes lost, changed and added */
    KIND_HOSTILE, /* any order of the bytes that mean something */
    KIND_MARKERS, /* nothing but the first byte of candidates */
    KIND_COUNT
};

/* A frame that the protocol can carry. */
canser_frame random_frame(int protocol);

/* Make a frame wrong in one way. Returns false if the protocol carries it. */
bool spoil(int protocol, int refusal, canser_frame *f);

/* Returns the length. */
size_t random_packet(int protocol, uint8_t out[CANSER_PACKET_MAX]);

void make_stream(int protocol, int kind, uint8_t *stream, size_t len);

#endif
