"""The arrows of the house: imports run one way, and `import canser` brings little."""

import ast
import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import canser

PACKAGE = Path(canser.__file__).parent

# The floors of the house, the lowest first. A folder or a module of the root imports from its own
# floor's folders never, and from the floors below only; within a folder there is no circle.
FLOORS = [
    ["_checks", "_guards", "_named", "_progress", "_quantities", "errors"],
    ["_frames", "_input", "_output", "_threads"],
    ["_core", "_dates", "_rows"],
    ["_notation", "_protocols"],
    ["_items", "adapters", "codec"],
    ["simulation", "timing"],
    ["recording", "tables"],
    ["files"],
    ["live"],
    ["_display", "analysis", "signals"],
    ["", "monitoring", "plots", "python_can"],
    ["commands"],
    ["__main__"],
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}


def room(module: str) -> str:
    """Return the folder or the module of the root that a module is or lies in, "" for canser."""
    return [*module.split("."), ""][1]


# Packages that are imported where they are used, in a function, by these modules only.
WHERE_USED = {
    "asammdf": {"canser.files.mf4"},
    "cantools": {"canser.signals.dbc"},
    "backports": {"canser.files.packed"},
    "compression": {"canser.files.packed"},  # Python's own from 3.14 on
    "matplotlib": {
        "canser.commands.plot",
        *(
            f"canser.plots._{name}"
            for name in (
                *("compare", "ids", "load", "overview", "payload", "periods", "raster"),
                *("samples", "signals", "stream", "style", "timeline"),
            )
        ),
    },
    "pyarrow": {"canser.files.columns", "canser.files.parquet", "canser.signals.parquet"},
    "isal": {"canser.files.containers", "canser.files.packed"},
    "rich": {"canser._progress", "canser.monitoring._table", "canser.monitoring.monitor"},
    "shtab": {"canser.commands.cli"},
    "serial": {"canser.live.line", "canser.live.ports", "canser.live.rfc2217"},
    "textual": {"canser.monitoring._table", "canser.monitoring.monitor"},
}

# Modules that other programs load, as plugins of theirs, and nobody here does: they import the
# package of those programs right at their top.
PLUGINS = {
    "can": {
        "canser.python_can.bus",
        "canser.python_can.logreader",
        "canser.python_can.logwriter",
    }
}


def modules() -> list[tuple[str, ast.Module]]:
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found.append((name, ast.parse(path.read_text(encoding="utf-8"))))
    return found


MODULES = modules()
NAMES = {name for name, _ in MODULES}


def imports(tree: ast.Module) -> set[str]:
    """Return every module that is imported anywhere in a file."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & NAMES
            names |= submodules or {node.module}
    return names


def ours(tree: ast.Module) -> set[str]:
    return {module for module in imports(tree) if module.split(".")[0] == "canser"}


def test_every_room_has_a_floor() -> None:
    assert {room(name) for name in NAMES} | {"_core"} == FLOOR.keys()


@pytest.mark.parametrize(("name", "tree"), MODULES, ids=[name for name, _ in MODULES])
def test_imports_run_downwards(name: str, tree: ast.Module) -> None:
    here = room(name)
    others = {module for module in ours(tree) if room(module) != here}
    assert not {module for module in others if FLOOR[room(module)] >= FLOOR[here]}


def test_there_is_no_circle() -> None:
    below = {name: ours(tree) & NAMES - {name} for name, tree in MODULES}
    while below:
        free = {name for name, used in below.items() if not used & below.keys()}
        assert free, f"a circle in {sorted(below)}"
        below = {name: used for name, used in below.items() if name not in free}


@pytest.mark.parametrize(("name", "tree"), MODULES, ids=[name for name, _ in MODULES])
def test_only_the_binding_knows_the_compiled_module(name: str, tree: ast.Module) -> None:
    assert "canser._core._lib" not in imports(tree) or name.startswith("canser._core.")
    assert "cffi" not in imports(tree)


@pytest.mark.parametrize(("name", "tree"), MODULES, ids=[name for name, _ in MODULES])
def test_other_packages_are_few(name: str, tree: ast.Module) -> None:
    known = {*sys.stdlib_module_names, "canser", "numpy", "typing_extensions"}
    others = {module.split(".")[0] for module in imports(tree)} - known
    users = [*WHERE_USED.items(), *PLUGINS.items()]
    assert others <= {package for package, modules in users if name in modules}


def test_the_plugins_are_declared() -> None:
    """Where the tests run and the package is not installed, those of the plugins are skipped."""
    pytest.importorskip("can")
    project = PACKAGE.parent / "pyproject.toml"
    if not project.exists():
        pytest.skip("the package is installed, and its declarations are elsewhere")
    declared = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["entry-points"]
    modules = set()
    for group in declared.values():
        for target in group.values():
            module, _, name = target.partition(":")
            modules.add(module)
            assert isinstance(getattr(importlib.import_module(module), name), type)
    assert modules == set().union(*PLUGINS.values())
    assert set(declared) == {"can.interface", "can.io.message_reader", "can.io.message_writer"}


def test_nobody_imports_a_plugin() -> None:
    plugins = set().union(*PLUGINS.values())
    assert not {name for name, tree in MODULES if imports(tree) & plugins}


def loaded_by(code: str) -> set[str]:
    code = f"{code}; import sys; print('\\n'.join(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_import_canser_brings_nothing_yet() -> None:
    assert not {"numpy", "_cffi_backend", "canser.errors"} & loaded_by("import canser")


def test_all_public_names_bring_numpy_and_cffi_only() -> None:
    loaded = loaded_by("from canser import *")
    assert {"canser.codec.decoder", "numpy"} <= loaded
    unwanted = {"serial", "asyncio", "can", "pandas", "pyarrow", "rich", "textual", "matplotlib"}
    unwanted |= {"argparse"}
    assert not unwanted & loaded


def test_protocols_are_named_in_c_only() -> None:
    for name, tree in MODULES:
        texts = {
            node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        assert not texts & {"cantalope", "seeed"}, name


# What arrays of frames are called in the package.
FRAMES = {"frames", "batch", "block", "room", "rows", "records", "out", "_out", "rows_to_frames"}


@pytest.mark.parametrize("tree", [tree for _, tree in MODULES], ids=[name for name, _ in MODULES])
def test_frames_are_copied_whole(tree: ast.Module) -> None:
    """`copy` and an array as index work field by field; see `put_records`, and use `compress`."""
    slow = set()
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(value=array, attr="copy"), args=[]):
                pass
            case ast.Subscript(value=ast.Name() as array, slice=ast.Call() | ast.Attribute()):
                pass
            case _:
                continue
        names = {part.id for part in ast.walk(array) if isinstance(part, ast.Name)}
        names |= {part.attr for part in ast.walk(array) if isinstance(part, ast.Attribute)}
        if names & FRAMES:
            slow.add(ast.unparse(node))
    assert not slow
