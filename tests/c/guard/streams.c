#include "streams.h"
#include "arena.h"
#include "checks.h"

drive driven;
plain_stream open_stream, ended_stream;

/* The rows of three decodings. */
static struct {
    canser_frame frames[ROW_CAP];
    int64_t offsets[ROW_CAP];
    int64_t ends[ROW_CAP];
    canser_control controls[ROW_CAP];
} rows[3];

void set_up_streams(void)
{
    slots_set_up(ROW_CAP * sizeof(canser_control));
    driven = (drive){.frames = rows[0].frames,
                     .offsets = rows[0].offsets,
                     .ends = rows[0].ends,
                     .controls = rows[0].controls,
                     .row_cap = ROW_CAP,
                     .place = place,
                     .drop = drop};
    open_stream = (plain_stream){.frames = rows[1].frames,
                                 .offsets = rows[1].offsets,
                                 .ends = rows[1].ends,
                                 .controls = rows[1].controls,
                                 .row_cap = ROW_CAP};
    ended_stream = (plain_stream){.frames = rows[2].frames,
                                  .offsets = rows[2].offsets,
                                  .ends = rows[2].ends,
                                  .controls = rows[2].controls,
                                  .row_cap = ROW_CAP};
}

void expect_streams(const uint8_t *stream, size_t len, int64_t tick_ns)
{
    now.len = len;
    plain_begin(&open_stream, now.protocol, tick_ns);
    plain_scan(&open_stream, stream, len, false);
    plain_begin(&ended_stream, now.protocol, tick_ns);
    plain_scan(&ended_stream, stream, len, true);
}
