"""Columns of Arrow as frames, by pyarrow."""

from typing import Any

from canser.errors import FormatError
from canser.files.tags import Tagged
from canser.tables.arrow import arrow_columns
from canser.tables.build import RowError, build_frames, missing_columns
from canser.tables.names import NATIVE, names_in

__all__ = ["from_batch", "load_pyarrow"]


def load_pyarrow(name: str) -> Any:
    """Return the module pyarrow; FormatError names the file if it is not installed."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an optional extra
    except ImportError:
        raise FormatError(
            f"{name} needs pyarrow, which is not installed: pip install 'canser[arrow]'"
        ) from None
    return pa


def from_batch(pa: Any, batch: Any, name: str, first: int) -> Tagged:
    """Return the frames of a RecordBatch; FormatError if it has other columns, or no CAN frames.

    `first` is the number of frames before it.
    """
    titles = names_in(batch.schema.names)
    missing = missing_columns(titles.values())
    if missing:
        raise FormatError(
            f"{name}: no column {', '.join(missing)}; canser reads the columns {', '.join(NATIVE)}"
        )
    try:
        columns = arrow_columns(pa, batch, titles)
        frames, channels, directions = build_frames(columns, batch.num_rows)
    except RowError as error:
        raise FormatError(f"{name}, frame {first + error.index}: {error.reason}") from None
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise FormatError(f"{name}: a column is not as canser writes it: {reason}") from None
    return Tagged(
        frames,
        channels if "channel" in columns else None,
        directions if "sent" in columns else None,
    )
