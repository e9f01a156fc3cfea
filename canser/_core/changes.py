"""Frames whose payload changes: C's work for each frame, and its memory."""

import secrets
from typing import Final

from canser._core._lib import ffi, lib
from canser._core.buffers import NULL, input_frames, output_frames, raise_status
from canser._core.text import Codes
from canser._frames import FrameArray

__all__ = ["copy_changes"]

# Places for ids at first.
_FIRST: Final = 4096


def copy_changes(frames: FrameArray, channels: Codes | None, out: FrameArray) -> int:
    """Copy the first frame of each id, kind and channel, and all changes to `out`.

    `frames` are contiguous; `out` is as long as they. Returns the number of those that are copied.
    """
    changes, used, found = ffi.new("canser_changes *"), ffi.new("size_t *"), ffi.new("size_t *")
    changes.spread = secrets.randbits(64) | 1
    frames_at, out_at = input_frames(frames), output_frames(out)
    channels_at = NULL if channels is None else ffi.from_buffer("uint8_t[]", channels)
    cap, done, count, lasts = _FIRST, 0, 0, None
    while done < len(frames):
        before = lasts  # in use until they are moved
        lasts = ffi.new("canser_last[]", cap)
        _check(lib.canser_changes_move(changes, lasts, cap))
        del before
        told = channels_at and channels_at + done
        left = len(frames) - done
        _check(
            lib.canser_changes_add(
                changes, frames_at + done, left, told, out_at + count, left, used, found
            )
        )
        done, count, cap = done + used[0], count + found[0], 4 * cap
    return int(count)


def _check(status: int) -> None:
    if status:
        raise_status(status)
