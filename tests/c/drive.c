#include "drive.h"

#include <string.h>

static void check(drive *self, bool holds, const char *law)
{
    if (!holds && !self->broken)
        self->broken = law;
}

void drive_begin(drive *self, int protocol, int64_t tick_ns)
{
    self->frame_count = 0;
    self->control_count = 0;
    self->broken = NULL;
    if (canser_decoder_init(&self->decoder, canser_protocol_at((size_t)protocol), tick_ns))
        self->broken = "init returns an error";
}

/* What must hold between any two calls. */
static void check_laws(drive *self)
{
    const canser_stats *stats = &self->decoder.stats;
    const uint64_t pending = self->decoder.carry_len;
    uint64_t rejects = 0;

    for (size_t i = 0; i < CANSER_REJECT_COUNT; i++)
        rejects += stats->rejects[i];
    check(self, pending <= CANSER_PACKET_MAX, "more is held than the longest packet");
    check(self,
          stats->bytes_in ==
              stats->bytes_framed + stats->bytes_control + stats->bytes_skipped + pending,
          "the bytes do not add up");
    check(self, rejects == stats->bytes_skipped, "the rejects do not add up");
    check(self, stats->resyncs <= stats->bytes_skipped, "more resyncs than skipped bytes");
    check(self, stats->frames == self->frame_count, "stats.frames is not the frames given");
    check(self, self->no_controls || stats->controls == self->control_count,
          "stats.controls is not the control packets given");
}

/* One call, feed or flush, on the arrays of the batch. Returns the bytes used. */
static size_t call(drive *self, canser_decoder *decoder, const uint8_t *bytes, size_t len,
                   bool flush, canser_batch *batch)
{
    const uint64_t before = decoder->stats.bytes_in;
    size_t used = SIZE_MAX;
    int status;

    batch->frame_count = SIZE_MAX;
    batch->control_count = SIZE_MAX;
    if (flush) {
        used = 0;
        status = canser_decoder_flush(decoder, batch);
    } else {
        status = canser_decoder_feed(decoder, bytes, len, batch, &used);
    }
    check(self, status == CANSER_OK, "the status is not OK");
    check(self, used <= len, "more is used than was there");
    check(self, decoder->stats.bytes_in - before == used, "bytes_in is not what was used");
    check(self, batch->frame_count <= batch->frame_cap, "frame_count is over frame_cap");
    check(self, batch->control_count <= (batch->controls ? batch->control_cap : 0),
          "control_count is over control_cap");
    return used;
}

/* What stands in an array before a call: no value that the decoder writes. */
enum { UNTOUCHED = 0xA5 };

static void *place_array(drive *self, drive_slot slot, size_t size)
{
    void *p = self->place(slot, size);

    memset(p, UNTOUCHED, size);
    return p;
}

/* Take the `count` rows that were written, see that the others were not. */
static void take_array(drive *self, drive_slot slot, void *to, void *from, size_t count, size_t cap,
                       size_t row_size)
{
    const uint8_t *bytes = from;
    bool untouched = true;

    if (!self->broken)
        memcpy(to, from, count * row_size);
    for (size_t i = count * row_size; i < cap * row_size && !self->broken; i++)
        untouched &= bytes[i] == UNTOUCHED;
    check(self, untouched, "a row past the count was written");
    self->drop(slot, from, cap * row_size);
}

/* One call whose decoder, input and arrays live only as long as itself. */
static size_t call_placed(drive *self, const uint8_t *bytes, size_t len, bool flush,
                          canser_batch *batch)
{
    const canser_batch own = *batch;
    const size_t frame_cap = own.frame_cap, control_cap = own.control_cap;
    canser_decoder *decoder = self->place(DRIVE_DECODER, sizeof *decoder);
    uint8_t *input = self->place(DRIVE_INPUT, len);

    *decoder = self->decoder;
    if (len)
        memcpy(input, bytes, len);
    batch->frames = place_array(self, DRIVE_FRAMES, frame_cap * sizeof *own.frames);
    if (own.offsets)
        batch->offsets = place_array(self, DRIVE_OFFSETS, frame_cap * sizeof *own.offsets);
    if (own.ends)
        batch->ends = place_array(self, DRIVE_ENDS, frame_cap * sizeof *own.ends);
    if (own.controls)
        batch->controls = place_array(self, DRIVE_CONTROLS, control_cap * sizeof *own.controls);

    const size_t used = call(self, decoder, input, len, flush, batch);
    self->decoder = *decoder;
    check(self, !len || memcmp(input, bytes, len) == 0, "the input was written to");

    take_array(self, DRIVE_FRAMES, own.frames, batch->frames, batch->frame_count, frame_cap,
               sizeof *own.frames);
    if (own.offsets)
        take_array(self, DRIVE_OFFSETS, own.offsets, batch->offsets, batch->frame_count, frame_cap,
                   sizeof *own.offsets);
    if (own.ends)
        take_array(self, DRIVE_ENDS, own.ends, batch->ends, batch->frame_count, frame_cap,
                   sizeof *own.ends);
    if (own.controls)
        take_array(self, DRIVE_CONTROLS, own.controls, batch->controls, batch->control_count,
                   control_cap, sizeof *own.controls);
    self->drop(DRIVE_INPUT, input, len);
    self->drop(DRIVE_DECODER, decoder, sizeof *decoder);
    return used;
}

/* Call once and append what comes to the rows. Returns the bytes used; `*full`
 * says whether an array was full, so that there may be more to come. */
static size_t call_and_append(drive *self, const uint8_t *bytes, size_t len, bool flush,
                              size_t frame_cap, size_t control_cap, bool *full)
{
    const size_t frame_room = self->row_cap - self->frame_count;
    const size_t control_room = self->row_cap - self->control_count;
    canser_batch batch = {
        .frames = self->frames + self->frame_count,
        .frame_cap = frame_cap < frame_room ? frame_cap : frame_room,
        .offsets = self->no_offsets ? NULL : self->offsets + self->frame_count,
        .ends = self->no_ends ? NULL : self->ends + self->frame_count,
        .controls = self->no_controls ? NULL : self->controls + self->control_count,
        .control_cap = control_cap < control_room ? control_cap : control_room,
    };
    size_t used = 0;

    *full = false;
    check(self, batch.frame_cap > 0 && batch.control_cap > 0, "more is found than can be there");
    if (self->broken)
        return 0;
    if (self->place)
        used = call_placed(self, bytes, len, flush, &batch);
    else
        used = call(self, &self->decoder, bytes, len, flush, &batch);
    if (self->broken)
        return 0;
    self->frame_count += batch.frame_count;
    self->control_count += batch.control_count;
    check_laws(self);
    *full = batch.frame_count == batch.frame_cap ||
            (!self->no_controls && batch.control_count == batch.control_cap);
    return used;
}

void drive_feed(drive *self, const uint8_t *bytes, size_t len, size_t frame_cap, size_t control_cap)
{
    size_t pos = 0;
    bool full;

    do {
        pos += call_and_append(self, bytes + pos, len - pos, false, frame_cap, control_cap, &full);
    } while (full && !self->broken);
    check(self, pos == len, "a call stopped before its end without need");
}

void drive_flush(drive *self, size_t frame_cap, size_t control_cap)
{
    bool full;

    do {
        call_and_append(self, NULL, 0, true, frame_cap, control_cap, &full);
    } while (full && !self->broken);
    check(self, self->decoder.carry_len == 0, "a flush stopped before its end without need");
}

const char *drive_compare(const drive *self, const plain_stream *expected)
{
    const size_t frame_count = expected->frame_count;
    const size_t control_count = expected->control_count;

    if (self->broken)
        return self->broken;
    if (self->frame_count != frame_count)
        return "the number of frames differs";
    /* The records have no padding: every byte of them counts. */
    if (memcmp(self->frames, expected->frames, frame_count * sizeof *self->frames) != 0)
        return "a frame differs";
    if (!self->no_offsets &&
        memcmp(self->offsets, expected->offsets, frame_count * sizeof *self->offsets) != 0)
        return "an offset differs";
    if (!self->no_ends && memcmp(self->ends, expected->ends, frame_count * sizeof *self->ends) != 0)
        return "an end differs";
    if (!self->no_controls) {
        if (self->control_count != control_count)
            return "the number of control packets differs";
        if (memcmp(self->controls, expected->controls, control_count * sizeof *self->controls) != 0)
            return "a control packet differs";
    }
    if (memcmp(&self->decoder.stats, &expected->stats, sizeof expected->stats) != 0)
        return "a statistic differs";
    if (self->decoder.carry_len != expected->pending)
        return "the bytes held differ";
    return NULL;
}
