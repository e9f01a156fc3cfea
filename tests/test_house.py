"""The arrows of the house: imports run one way, and `import canser` brings little."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import canser

PACKAGE = Path(canser.__file__).parent

# The floors of the house. A module imports from the floors below its own only.
FLOORS = [
    ["canser._core", "canser.errors", "canser.frames", "canser._progress"],
    [
        "canser._binding",
        "canser._output",
        "canser.formats._text",
        "canser.formats.npy",
        "canser.tally",
    ],
    ["canser.parallel", "canser.sinks"],
    ["canser.codec", "canser.formats.candump", "canser.formats.csv", "canser.traffic"],
    ["canser.captures", "canser.formats", "canser.identify"],
    ["canser.files", "canser.report"],
    ["canser.convert", "canser"],
    ["canser.cli"],
    ["canser.__main__"],
]
FLOOR = {module: number for number, modules in enumerate(FLOORS) for module in modules}

# Packages that are imported where they are used, in a function, by this module only.
WHERE_USED = {"rich": "canser._progress"}


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
    assert others <= {package for package, user in WHERE_USED.items() if user == name}


def test_import_canser_brings_numpy_and_cffi_only() -> None:
    code = "import sys, canser; print('\\n'.join(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {"canser", "numpy"} <= loaded
    unwanted = {"serial", "can", "pandas", "pyarrow", "rich", "matplotlib", "argparse"}
    assert not unwanted & loaded


def test_protocols_are_named_in_c_only() -> None:
    for name, tree in MODULES:
        texts = {
            node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        assert not texts & {"cantalope", "seeed"}, name
