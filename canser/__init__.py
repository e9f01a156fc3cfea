"""Decode and encode the byte streams of serial CAN adapters, into numpy arrays.

This module has all public names. A name's module is loaded when the name is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from canser._core.stream import Control as Control
    from canser._display import load_ipython_extension as load_ipython_extension
    from canser._display import show as show
    from canser._display import unload_ipython_extension as unload_ipython_extension
    from canser._frames import FRAME_DTYPE as FRAME_DTYPE
    from canser._frames import NO_TIME as NO_TIME
    from canser._frames import FrameArray as FrameArray
    from canser._frames import concat as concat
    from canser._frames import match as match
    from canser._items import frames as frames
    from canser._protocols import Protocol as Protocol
    from canser._protocols import protocol as protocol
    from canser._protocols import protocols as protocols
    from canser.adapters import AdapterConfig as AdapterConfig
    from canser.adapters import AdapterReport as AdapterReport
    from canser.analysis.compare import Comparison as Comparison
    from canser.analysis.compare import compare as compare
    from canser.analysis.dropouts import DROPOUT_DTYPE as DROPOUT_DTYPE
    from canser.analysis.dropouts import dropouts as dropouts
    from canser.analysis.groups import IdGroups as IdGroups
    from canser.analysis.groups import by_id as by_id
    from canser.analysis.groups import changes as changes
    from canser.analysis.ids import ID_STATS_DTYPE as ID_STATS_DTYPE
    from canser.analysis.ids import IdStats as IdStats
    from canser.analysis.ids import id_stats as id_stats
    from canser.analysis.load import LOAD_DTYPE as LOAD_DTYPE
    from canser.analysis.load import BusLoad as BusLoad
    from canser.analysis.load import bus_load as bus_load
    from canser.analysis.summary import FileInfo as FileInfo
    from canser.analysis.summary import info as info
    from canser.analysis.times import between as between
    from canser.analysis.times import merge as merge
    from canser.codec.bits import frame_bits as frame_bits
    from canser.codec.decoder import Decoder as Decoder
    from canser.codec.decoder import Stats as Stats
    from canser.codec.decoder import decode as decode
    from canser.codec.decoder import encode as encode
    from canser.errors import CanserError as CanserError
    from canser.errors import CanserWarning as CanserWarning
    from canser.errors import ForeignFormatError as ForeignFormatError
    from canser.errors import FormatError as FormatError
    from canser.errors import NoProtocolError as NoProtocolError
    from canser.errors import OutputExistsError as OutputExistsError
    from canser.errors import PortBusyError as PortBusyError
    from canser.errors import PortClosedError as PortClosedError
    from canser.errors import PortDeniedError as PortDeniedError
    from canser.errors import PortError as PortError
    from canser.errors import PortGoneError as PortGoneError
    from canser.errors import PortNotFoundError as PortNotFoundError
    from canser.errors import ReaderGoneError as ReaderGoneError
    from canser.errors import RecordingError as RecordingError
    from canser.errors import SendError as SendError
    from canser.errors import SendTimeoutError as SendTimeoutError
    from canser.errors import StreamClosedError as StreamClosedError
    from canser.errors import WrongProtocolError as WrongProtocolError
    from canser.files.fits import Fit as Fit
    from canser.files.fits import identify as identify
    from canser.files.reading import Blocks as Blocks
    from canser.files.reading import FilePart as FilePart
    from canser.files.reading import Notes as Notes
    from canser.files.reading import blocks as blocks
    from canser.files.reading import read as read
    from canser.files.writing import Converted as Converted
    from canser.files.writing import convert as convert
    from canser.files.writing import write as write
    from canser.live.config import LineConfig as LineConfig
    from canser.live.ports import Port as Port
    from canser.live.ports import PortInfo as PortInfo
    from canser.live.ports import list_ports as list_ports
    from canser.live.ports import open as open  # noqa: A004 - as in gzip.open
    from canser.live.recorder import Recorder as Recorder
    from canser.live.recording import RecordConfig as RecordConfig
    from canser.live.recording import RecorderEvent as RecorderEvent
    from canser.live.recording import RecorderStatus as RecorderStatus
    from canser.live.ring import Gap as Gap
    from canser.live.run import record as record
    from canser.recording.header import RecordingInfo as RecordingInfo
    from canser.signals.database import Database as Database
    from canser.signals.decoder import SignalDecoder as SignalDecoder
    from canser.signals.messages import Message as Message
    from canser.signals.messages import SignalInfo as SignalInfo
    from canser.signals.report import UNKNOWN_ID_DTYPE as UNKNOWN_ID_DTYPE
    from canser.signals.report import DecodeReport as DecodeReport
    from canser.signals.signal import Signal as Signal
    from canser.signals.signals import Group as Group
    from canser.signals.signals import Resampled as Resampled
    from canser.signals.signals import Signals as Signals
    from canser.simulation.faults import Faults as Faults
    from canser.simulation.simulator import Simulator as Simulator
    from canser.simulation.simulator import SimulatorReport as SimulatorReport
    from canser.tables.convert import from_arrow as from_arrow
    from canser.tables.convert import from_pandas as from_pandas
    from canser.tables.convert import from_polars as from_polars
    from canser.tables.convert import from_xarray as from_xarray
    from canser.tables.convert import to_arrow as to_arrow
    from canser.tables.convert import to_pandas as to_pandas
    from canser.tables.convert import to_polars as to_polars
    from canser.tables.convert import to_xarray as to_xarray
    from canser.tables.table import Table as Table
    from canser.tables.table import table as table
    from canser.timing.clocks import ClockEstimate as ClockEstimate

    __version__: str

# The public names by the module that makes them; type checkers read the imports above.
_HOMES: Final = {
    "canser._core.stream": ("Control",),
    "canser._display": (
        "load_ipython_extension",
        "show",
        "unload_ipython_extension",
    ),
    "canser._frames": (
        "FRAME_DTYPE",
        "NO_TIME",
        "FrameArray",
        "concat",
        "match",
    ),
    "canser._items": ("frames",),
    "canser._protocols": (
        "Protocol",
        "protocol",
        "protocols",
    ),
    "canser.adapters": (
        "AdapterConfig",
        "AdapterReport",
    ),
    "canser.analysis.compare": (
        "Comparison",
        "compare",
    ),
    "canser.analysis.dropouts": (
        "DROPOUT_DTYPE",
        "dropouts",
    ),
    "canser.analysis.groups": (
        "IdGroups",
        "by_id",
        "changes",
    ),
    "canser.analysis.ids": (
        "ID_STATS_DTYPE",
        "IdStats",
        "id_stats",
    ),
    "canser.analysis.load": (
        "LOAD_DTYPE",
        "BusLoad",
        "bus_load",
    ),
    "canser.analysis.summary": (
        "FileInfo",
        "info",
    ),
    "canser.analysis.times": (
        "between",
        "merge",
    ),
    "canser.codec.bits": ("frame_bits",),
    "canser.codec.decoder": (
        "Decoder",
        "Stats",
        "decode",
        "encode",
    ),
    "canser.errors": (
        "CanserError",
        "CanserWarning",
        "ForeignFormatError",
        "FormatError",
        "NoProtocolError",
        "OutputExistsError",
        "PortBusyError",
        "PortClosedError",
        "PortDeniedError",
        "PortError",
        "PortGoneError",
        "PortNotFoundError",
        "ReaderGoneError",
        "RecordingError",
        "SendError",
        "SendTimeoutError",
        "StreamClosedError",
        "WrongProtocolError",
    ),
    "canser.files.fits": (
        "Fit",
        "identify",
    ),
    "canser.files.reading": (
        "Blocks",
        "FilePart",
        "Notes",
        "blocks",
        "read",
    ),
    "canser.files.writing": (
        "Converted",
        "convert",
        "write",
    ),
    "canser.live.config": ("LineConfig",),
    "canser.live.ports": (
        "Port",
        "PortInfo",
        "list_ports",
        "open",
    ),
    "canser.live.recorder": ("Recorder",),
    "canser.live.recording": (
        "RecordConfig",
        "RecorderEvent",
        "RecorderStatus",
    ),
    "canser.live.ring": ("Gap",),
    "canser.live.run": ("record",),
    "canser.recording.header": ("RecordingInfo",),
    "canser.signals.database": ("Database",),
    "canser.signals.decoder": ("SignalDecoder",),
    "canser.signals.messages": (
        "Message",
        "SignalInfo",
    ),
    "canser.signals.report": (
        "UNKNOWN_ID_DTYPE",
        "DecodeReport",
    ),
    "canser.signals.signal": ("Signal",),
    "canser.signals.signals": (
        "Group",
        "Resampled",
        "Signals",
    ),
    "canser.simulation.faults": ("Faults",),
    "canser.simulation.simulator": (
        "Simulator",
        "SimulatorReport",
    ),
    "canser.tables.convert": (
        "from_arrow",
        "from_pandas",
        "from_polars",
        "from_xarray",
        "to_arrow",
        "to_pandas",
        "to_polars",
        "to_xarray",
    ),
    "canser.tables.table": (
        "Table",
        "table",
    ),
    "canser.timing.clocks": ("ClockEstimate",),
}
_HOME: Final = {name: module for module, names in _HOMES.items() for name in names}

# Hidden from type checkers: they cannot read this list, and would accept any name for __getattr__.
if not TYPE_CHECKING:
    __all__ = [*_HOME, "__version__"]  # noqa: PLE0604 - they are strings

    def __getattr__(name: str) -> Any:
        if name in _HOME:
            value = getattr(import_module(_HOME[name]), name)
        elif name == "__version__":
            from importlib.metadata import version  # noqa: PLC0415 - slow, and seldom asked for

            value = version("canser")
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value  # found at once from now on
        return value

    def __dir__() -> list[str]:
        return sorted(__all__)
