"""What a user finds in `canser`, and what else is public."""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

import canser

NAMES = [
    "AdapterConfig",
    "AdapterReport",
    "Blocks",
    "BusLoad",
    "Converted",
    "Faults",
    "FilePart",
    "convert",
    "write",
    "CanserError",
    "CanserWarning",
    "ClockEstimate",
    "Control",
    "Decoder",
    "FRAME_DTYPE",
    "FileInfo",
    "Fit",
    "ForeignFormatError",
    "FormatError",
    "FrameArray",
    "Gap",
    "LOAD_DTYPE",
    "LineConfig",
    "NO_TIME",
    "NoProtocolError",
    "Notes",
    "OutputExistsError",
    "Port",
    "PortBusyError",
    "PortClosedError",
    "PortDeniedError",
    "PortError",
    "PortGoneError",
    "PortInfo",
    "PortNotFoundError",
    "Protocol",
    "ReaderGoneError",
    "RecordConfig",
    "Recorder",
    "RecorderEvent",
    "RecorderStatus",
    "RecordingError",
    "RecordingInfo",
    "Resampled",
    "Database",
    "DecodeReport",
    "UNKNOWN_ID_DTYPE",
    "Group",
    "Message",
    "Signal",
    "SignalDecoder",
    "SignalInfo",
    "Signals",
    "SendError",
    "SendTimeoutError",
    "Simulator",
    "SimulatorReport",
    "Stats",
    "StreamClosedError",
    "Table",
    "WrongProtocolError",
    "Comparison",
    "DROPOUT_DTYPE",
    "ID_STATS_DTYPE",
    "IdGroups",
    "IdStats",
    "__version__",
    "between",
    "blocks",
    "bus_load",
    "concat",
    "decode",
    "encode",
    "frame_bits",
    "frames",
    "identify",
    "info",
    "list_ports",
    "load_ipython_extension",
    "match",
    "merge",
    "open",
    "protocol",
    "protocols",
    "read",
    "record",
    "show",
    "table",
    "by_id",
    "changes",
    "compare",
    "dropouts",
    "from_arrow",
    "from_pandas",
    "from_polars",
    "from_xarray",
    "id_stats",
    "to_arrow",
    "to_pandas",
    "to_polars",
    "to_xarray",
    "unload_ipython_extension",
]

# Besides `canser` itself. All else is private: by its name, or by the first word of its docstring.
MODULES = {"adapters", "errors", "plots", "python_can", "simulation"}


def test_the_names_are_these() -> None:
    exported: list[str] = canser.__all__  # type: ignore[attr-defined]
    assert sorted(exported) == sorted(NAMES) == sorted(dir(canser))


@pytest.mark.parametrize("name", NAMES)
def test_each_name_is_there(name: str) -> None:
    value = getattr(canser, name)
    assert value is getattr(canser, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert inspect.getdoc(value)


def test_another_name_is_an_error_that_says_so() -> None:
    with pytest.raises(AttributeError, match="module 'canser' has no attribute 'decoed'"):
        canser.decoed  # type: ignore[attr-defined]  # noqa: B018


def test_type_checkers_see_the_names_where_they_are_loaded_from() -> None:
    tree = ast.parse(Path(canser.__file__).read_text(encoding="utf-8"))
    typed = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("canser.")
        for alias in node.names
    }
    assert typed == canser._HOME


def test_all_exceptions_are_in_one_file_and_public() -> None:
    tree = ast.parse(Path(importlib.import_module("canser.errors").__file__ or "").read_text())
    assert {node.name for node in tree.body if isinstance(node, ast.ClassDef)} <= set(NAMES)


def test_all_else_is_private() -> None:
    found = {module.name for module in pkgutil.iter_modules(canser.__path__)}
    public = {name for name in found if not name.startswith("_")}
    folders = {name for name in public if (Path(canser.__path__[0]) / name).is_dir()}
    for name in folders - MODULES:
        doc = importlib.import_module(f"canser.{name}").__doc__ or ""
        assert doc.startswith("Private: "), name
    assert public - folders <= MODULES


def test_no_function_has_the_name_of_a_module() -> None:
    modules = {module.name for module in pkgutil.iter_modules(canser.__path__)}
    assert not modules & set(NAMES)
