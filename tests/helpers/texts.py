"""Texts of log files, read as `canser.blocks` reads files."""

import io
from typing import Any

from canser.files.reading import Blocks, checked_options
from reference import Frame
from samples import listed


def read_text(
    raw: bytes | io.RawIOBase | io.BytesIO, file_format: str, name: str = "x.log", **options: Any
) -> tuple[list[Frame], list[str]]:
    """Return the frames of a text, and the remarks on it without the file's name."""
    file = io.BytesIO(raw) if isinstance(raw, bytes) else raw
    file.name = name  # type: ignore[union-attr]
    checked = checked_options(file_format, **options)
    with Blocks(file, checked, format=file_format) as blocks:  # type: ignore[arg-type]
        frames = listed(blocks)
        return frames, [remark.removeprefix(f"{name}: ") for remark in blocks.notes.remarks]
