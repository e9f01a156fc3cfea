"""Runs of times and intervals of ids in plain Python, written from the contract of canser_runs."""

import math
from itertools import pairwise

from reference import NO_TIME, Frame
from samples import SECOND

Key = tuple[bool, bool, int, bool]

_HOUR = 3_600 * SECOND


def _hole(steps: list[int]) -> int:
    """Return the longest step that is no hole behind these steps."""
    if len(steps) < 10:
        return _HOUR
    most = sorted(steps)[len(steps) - len(steps) // 1_000 - 1]
    if most <= 50_000_000:
        return SECOND
    # Long steps are counted in eight bins for each power of two; the end of the bin counts.
    width = 1 << (most >> 1).bit_length() - 4
    return max(20 * 2 * ((most >> 1) // width + 1) * width, SECOND)


def plain_runs(times: list[int]) -> list[int]:
    """Return the run of each time when it comes, 0 for an unknown one."""
    runs, steps, numbers = list[int](), list[int](), 0
    now = before = (0, 0)  # number of the run, its last time
    since = jump = 0

    def continues(run: tuple[int, int], time: int) -> bool:
        return run[1] - SECOND <= time <= run[1] + _hole(steps)

    for time in times:
        if time == NO_TIME:
            runs.append(0)
            continue
        if since and continues(before, time):
            now, since = before, 0
        elif since:
            since += 1
            if since > 4:
                since = 0
                steps += [jump] if jump else []
        if numbers and continues(now, time):
            steps.append(max(time - now[1], 0))
            now = now[0], time
        else:
            if numbers and not since:
                before, jump, since = now, max(time - now[1], 0), 1
            numbers += 1
            now = numbers, time
        runs.append(now[0])
    return runs


def key_of(frame: Frame, remote_apart: bool) -> Key:
    return frame.err, frame.ext, frame.id, frame.rtr and remote_apart


def by_key(frames: list[Frame], remote_apart: bool) -> dict[Key, list[int]]:
    """Return the numbers of the frames of each row, the rows in their order."""
    keys = sorted({key_of(frame, remote_apart) for frame in frames})
    return {
        key: [i for i, frame in enumerate(frames) if key_of(frame, remote_apart) == key]
        for key in keys
    }


def plain_steps(frames: list[Frame], remote_apart: bool) -> dict[Key, list[int]]:
    """Return the intervals of each row."""
    runs = plain_runs([frame.ts for frame in frames])
    return {
        key: [
            frames[b].ts - frames[a].ts
            for a, b in pairwise(own)
            if runs[a] == runs[b] != 0 and 0 <= frames[b].ts - frames[a].ts < 2**63
        ]
        for key, own in by_key(frames, remote_apart).items()
    }


def ranked(values: list[int], share: float) -> int:
    """Return the shortest value that at least a share of all do not exceed."""
    return sorted(values)[max(math.ceil(share * len(values)), 1) - 1]
