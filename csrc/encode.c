/* Encoding: frames to bytes, and the reasons why a format cannot carry a frame. */
#include "protocol.h"

const char *canser_refusal_text(int refusal)
{
    static const char *const texts[CANSER_REFUSAL_COUNT] = {
        [CANSER_REFUSAL_NONE] = "",
        [CANSER_REFUSAL_DLC] = "its dlc is over 8",
        [CANSER_REFUSAL_ID] = "its id is over 0x7FF and ext is not set; set ext",
        [CANSER_REFUSAL_ID_EXT] = "its id is over 0x1FFFFFFF",
        [CANSER_REFUSAL_EXT] = "the format has no extended frames; leave them out",
        [CANSER_REFUSAL_ERR] = "the format has no error frames; leave them out",
        [CANSER_REFUSAL_TIME] = "the format needs a time and ts is not known (NaT); set ts",
    };
    return refusal >= 0 && refusal < CANSER_REFUSAL_COUNT ? texts[refusal] : NULL;
}

const char *canser_refusal_name(int refusal)
{
    static const char *const names[CANSER_REFUSAL_COUNT] = {
        [CANSER_REFUSAL_NONE] = "",
        [CANSER_REFUSAL_DLC] = "dlcs over 8",
        [CANSER_REFUSAL_ID] = "standard ids over 0x7FF",
        [CANSER_REFUSAL_ID_EXT] = "ids over 0x1FFFFFFF",
        [CANSER_REFUSAL_EXT] = "extended ids",
        [CANSER_REFUSAL_ERR] = "error frames",
        [CANSER_REFUSAL_TIME] = "unknown times",
    };
    return refusal >= 0 && refusal < CANSER_REFUSAL_COUNT ? names[refusal] : NULL;
}

int canser_encode(const canser_protocol *protocol, int64_t tick_ns, const canser_frame *frames,
                  size_t frame_count, uint8_t *out, size_t out_cap, canser_encoded *result)
{
    if (!result)
        return CANSER_NULL;
    *result = (canser_encoded){0, 0, CANSER_REFUSAL_NONE};
    if (!protocol || (!frames && frame_count) || (!out && out_cap))
        return CANSER_NULL;
    if (tick_ns < 1)
        return CANSER_TICK;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    if (spans_meet(span_of(frames, frame_count, sizeof *frames), span_of(out, out_cap, 1)))
        return CANSER_OVERLAP;

    if (frame_count && out_cap)
        protocol->codec->encode(frames, frame_count, tick_ns, out, out_cap, result);
    /* Too near the end of `out` for wide stores: each frame goes through a window. */
    while (!result->refusal && result->frame_count < frame_count) {
        uint8_t window[SCAN_WINDOW];
        canser_encoded one;

        protocol->codec->encode(frames + result->frame_count, 1, tick_ns, window, sizeof window,
                                &one);
        result->refusal = one.refusal;
        if (one.byte_count > out_cap - result->byte_count)
            break;
        if (one.byte_count)
            memcpy(out + result->byte_count, window, one.byte_count);
        result->byte_count += one.byte_count;
        result->frame_count += one.frame_count;
    }
    return result->refusal ? CANSER_REFUSED : CANSER_OK;
}

int canser_refuse(const canser_protocol *protocol, const canser_frame *frames, size_t frame_count,
                  uint8_t *refusals)
{
    if (!protocol || ((!frames || !refusals) && frame_count))
        return CANSER_NULL;
    if (misaligned(frames, _Alignof(canser_frame)))
        return CANSER_MISALIGNED;
    if (spans_meet(span_of(frames, frame_count, sizeof *frames), span_of(refusals, frame_count, 1)))
        return CANSER_OVERLAP;
    for (size_t i = 0; i < frame_count; i++)
        refusals[i] = (uint8_t)protocol->codec->refuse(frames + i);
    return CANSER_OK;
}
