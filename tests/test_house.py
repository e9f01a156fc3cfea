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

# The floors of the house. A module imports from the floors below its own only.
FLOORS = [
    [
        "canser._checks",
        "canser._named",
    ],
    [
        "canser._core",
        "canser._guards",
        "canser._input",
        "canser._progress",
        "canser._signals",
        "canser.errors",
        "canser.foreign",
        "canser.frames",
        "canser.live",
        "canser.monitoring",
        "canser.python_can",
        "canser.recordings",
        "canser.recordings._lock",
        "canser.recordings.pcapng",
        "canser.restarts",
        "canser.simulation",
        "canser.live.ring",
    ],
    [
        "canser._binding",
        "canser._output",
        "canser._threads",
        "canser.formats._remarks",
        "canser.live.line",
        "canser.live.meter",
        "canser.monitoring.livetable",
        "canser.recordings.recording",
        "canser.simulation._terminal",
        "canser.tally",
    ],
    [
        "canser._refusals",
        "canser.adapters",
        "canser.doubt",
        "canser.formats._text",
        "canser.formats.npy",
        "canser.live.link",
        "canser.parallel",
        "canser.recordings._old",
        "canser.simulation._ahead",
        "canser.sinks",
    ],
    [
        "canser.codec",
        "canser.formats.candump",
        "canser.formats.csv",
        "canser.simulation.traffic",
    ],
    [
        "canser.formats",
        "canser.identify",
        "canser.live.timing",
        "canser.simulation._outgoing",
    ],
    [
        "canser.live.stream",
        "canser.recordings.recorded",
        "canser.simulation.simulator",
    ],
    [
        "canser.judge",
        "canser.live.ports",
    ],
    [
        "canser.captures",
    ],
    [
        "canser.files",
        "canser.live.player",
        "canser.recordings.recorder",
        "canser.report",
    ],
    [
        "canser.convert",
        "canser.commands._common",
        "canser.commands._numbers",
        "canser",
    ],
    [
        "canser.commands._port",
        "canser.commands._screen",
        "canser.commands._traffic",
        "canser.commands._sending",
        "canser.monitoring._table",
        "canser.python_can._messages",
    ],
    [
        "canser.monitoring.monitor",
    ],
    [
        "canser.commands.convert",
        "canser.commands.dump",
        "canser.commands.info",
        "canser.commands.simulate",
        "canser.commands.recover",
        "canser.commands.log",
        "canser.commands.send",
        "canser.commands.play",
        "canser.commands.ports",
        "canser.commands.monitor",
    ],
    [
        "canser.commands",
    ],
    [
        "canser.cli",
    ],
    [
        "canser.__main__",
        "canser.python_can.bus",
        "canser.python_can.logreader",
    ],
]
FLOOR = {module: number for number, modules in enumerate(FLOORS) for module in modules}

# Packages that are imported where they are used, in a function, by these modules only.
WHERE_USED = {
    "rich": {"canser._progress", "canser.monitoring._table", "canser.monitoring.monitor"},
    "serial": {"canser.live.line", "canser.live.ports"},
    "textual": {"canser.monitoring._table", "canser.monitoring.monitor"},
}

# Modules that other programs load, as plugins of theirs, and nobody here does: they import the
# package of those programs right at their top.
PLUGINS = {"can": {"canser.python_can.bus", "canser.python_can.logreader"}}


def modules() -> list[tuple[str, ast.Module]]:
    found = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        found.append((name, ast.parse(path.read_text(encoding="utf-8"))))
    return found


def imports(tree: ast.Module) -> set[str]:
    """Return every module that is imported anywhere in a file."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & FLOOR.keys()
            names |= submodules or {node.module}
    return names


MODULES = modules()


def test_every_module_has_a_floor() -> None:
    assert {name for name, _ in MODULES} | {"canser._core"} == FLOOR.keys()


@pytest.mark.parametrize(("name", "tree"), MODULES, ids=[name for name, _ in MODULES])
def test_imports_run_downwards(name: str, tree: ast.Module) -> None:
    ours = {module for module in imports(tree) if module.split(".")[0] == "canser"}
    upwards = {module for module in ours if FLOOR[module] >= FLOOR[name]}
    assert not upwards


@pytest.mark.parametrize(("name", "tree"), MODULES, ids=[name for name, _ in MODULES])
def test_only_the_binding_knows_the_compiled_module(name: str, tree: ast.Module) -> None:
    assert "canser._core" not in imports(tree) or name == "canser._binding"
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
    assert set(declared) == {"can.interface", "can.io.message_reader"}


def test_nobody_imports_a_plugin() -> None:
    plugins = set().union(*PLUGINS.values())
    assert not {name for name, tree in MODULES if imports(tree) & plugins}


def test_import_canser_brings_numpy_and_cffi_only() -> None:
    code = "import sys, canser; print('\\n'.join(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {"canser", "numpy"} <= loaded
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
FRAMES = {"frames", "batch", "block", "room", "rows", "records", "out", "_out", "frames_of"}


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
