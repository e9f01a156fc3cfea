#include "bench.h"
#include "checks.h"
#include "traffic.h"

#include <string.h>

void set_bench(bench *b)
{
    memset(b, UINT8_MAX, sizeof *b);
    make_stream(now.protocol, KIND_CLEAN, b->data, sizeof b->data);
    canser_decoder_init(&b->decoder, canser_protocol_at((size_t)now.protocol), 1000);
    b->batch = (canser_batch){.frames = b->memory.frames,
                              .frame_cap = 4,
                              .offsets = b->offsets,
                              .ends = b->ends,
                              .controls = b->controls,
                              .control_cap = 4,
                              .frame_count = SIZE_MAX,
                              .control_count = SIZE_MAX};
    canser_decoder_feed(&b->decoder, b->data, 1, &b->batch, &b->used);
    check(b->decoder.carry_len == 1, "a marker is not held");
    b->batch.frame_count = b->batch.control_count = b->used = SIZE_MAX;
    memcpy(&b->before, &b->decoder, sizeof b->before); /* with its padding */
}

void check_arrays_kept(const bench *b, const bench *before)
{
    check(memcmp(&b->memory, &before->memory, sizeof b->memory) == 0 &&
              memcmp(b->offsets, before->offsets, sizeof b->offsets) == 0 &&
              memcmp(b->ends, before->ends, sizeof b->ends) == 0 &&
              memcmp(b->controls, before->controls, sizeof b->controls) == 0,
          "an array has changed");
}
