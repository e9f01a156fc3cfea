"""Docstrings of the public interface, as a tool reads them: griffe, by the rules of numpydoc."""

import ast
import dataclasses
import doctest
import inspect
import itertools
import logging
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import griffe
import numpy as np
import pytest
from griffe import DocstringSectionKind as Kind

import canser

logging.getLogger("griffe").setLevel(logging.ERROR)

# What raises nothing of its own, or what everything raises.
_NO_RAISES = {"NotImplementedError", "AssertionError", "StopIteration", "KeyboardInterrupt"}


def sections(docstring: str) -> dict[Kind, Any]:
    parsed = griffe.Docstring(docstring).parse("numpy")
    return {section.kind: section.value for section in parsed}


def function_of(member: Any) -> FunctionType | None:
    """Return the function behind a method, a class method or a property."""
    if isinstance(member, property):
        member = member.fget
    member = getattr(member, "__func__", member)
    member = inspect.unwrap(member) if callable(member) else None
    return member if isinstance(member, FunctionType) else None


def is_ours(member: Any) -> bool:
    return str(getattr(member, "__module__", "")).startswith("canser")


def public() -> Iterator[tuple[str, Any]]:
    """Yield every public function and class, and the public members of classes, by their names."""
    for name in dir(canser):
        thing = getattr(canser, name)
        if not callable(thing) or not is_ours(thing):
            continue
        yield name, thing
        if not inspect.isclass(thing):
            continue
        for owner in thing.__mro__:
            for attribute, member in vars(owner).items():
                function = function_of(member)
                if not is_ours(owner) or not function or attribute.startswith("_"):
                    continue
                if "this package's own use" not in (function.__doc__ or ""):
                    yield f"{name}.{attribute}", member


PUBLIC = dict(public())
FUNCTIONS = {name: thing for name, thing in PUBLIC.items() if function_of(thing)}
CLASSES = {name: thing for name, thing in PUBLIC.items() if inspect.isclass(thing)}


def parameters(function: FunctionType) -> list[str]:
    names = list(inspect.signature(function).parameters)
    return names[1:] if names and names[0] in ("self", "cls") else names


@cache
def tree(function: FunctionType) -> ast.AST:
    return ast.parse(inspect.cleandoc("\n" + inspect.getsource(function)).strip())


def raised(function: FunctionType) -> set[str]:
    """Return the exceptions that a function's own lines raise, by their names."""
    names = set()
    for node in ast.walk(tree(function)):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            names.add(ast.unparse(node.exc.func))
    return {name for name in names if name[0].isupper()} - _NO_RAISES


def listed(text: dict[Kind, Any], kind: Kind) -> list[str]:
    names = [str(getattr(item, "name", "") or item.annotation) for item in text.get(kind, [])]
    return [part.strip(" *") for name in names for part in name.split(",")]


def documented_fields(kind: type) -> set[str]:
    """Return the fields that a comment with `#:` or an Attributes section describes."""
    found: set[str] = set()
    for owner in kind.__mro__:
        if not is_ours(owner):
            continue
        found.update(listed(sections(owner.__doc__ or ""), Kind.attributes))
        lines = inspect.getsource(owner).splitlines()
        for before, line in itertools.pairwise(lines):
            field = re.match(r"\s+(\w+)\s*:", line)
            if field and (before.strip().startswith("#:") or "#:" in line):
                found.add(field[1])
    return found


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_says_what_it_takes_returns_and_raises(name: str) -> None:
    thing = FUNCTIONS[name]
    function = function_of(thing)
    assert function is not None
    text = inspect.getdoc(thing) or ""
    assert text, "there is no docstring"
    assert text.splitlines()[0].endswith((".", "?")), "the first line is no sentence"
    if isinstance(thing, property):
        return
    found = sections(text)
    assert listed(found, Kind.parameters) == parameters(function)
    for item in found.get(Kind.parameters, []):
        assert item.description.strip(), f"{item.name} is not described"
    if name.endswith((".__enter__", ".__exit__")):
        return
    returns = inspect.signature(function).return_annotation
    if returns not in (None, "None", inspect.Signature.empty) and "Never" not in str(returns):
        assert Kind.returns in found or Kind.yields in found, "what it returns is missing"
    missing = raised(function) - set(listed(found, Kind.raises))
    assert not missing, f"{missing} is raised, and not in Raises"


@pytest.mark.parametrize("name", CLASSES)
def test_a_class_says_what_makes_it_and_what_its_fields_are(name: str) -> None:
    kind = CLASSES[name]
    text = inspect.getdoc(kind) or ""
    assert text.splitlines()[0].endswith("."), "the first line is no sentence"
    fields = set()
    if dataclasses.is_dataclass(kind):
        fields = {field.name for field in dataclasses.fields(kind) if field.name[0] != "_"}
    elif issubclass(kind, tuple):
        fields = set(kind._fields)  # type: ignore[attr-defined]
    assert not fields - documented_fields(kind)
    init = kind.__init__
    if fields or issubclass(kind, BaseException):
        return
    if isinstance(init, FunctionType) and is_ours(init):
        # One that only other calls make is not made by a caller: its docstring says by which.
        by_others = re.search(r"(made|given|returned|yielded) by ", text)
        if not by_others:
            assert listed(sections(text), Kind.parameters) == parameters(init)


# The database that examples of signals open.
CAR_DBC = Path(__file__).parents[1] / "examples" / "car.dbc"


def has_example(text: str) -> bool:
    return any(example.source for example in doctest.DocTestParser().get_examples(text))


TOP = [name for name in PUBLIC if "." not in name and not name.endswith(("Error", "Warning"))]


# Extensions of a notebook are loaded by its own commands, which begin with a per cent sign.
@pytest.mark.parametrize("name", TOP)
def test_there_is_an_example(name: str) -> None:
    text = inspect.getdoc(PUBLIC[name]) or ""
    assert has_example(text) or "%" in text or re.search(r"(made|given|returned|yielded) by ", text)


@pytest.mark.parametrize("name", PUBLIC)
def test_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = inspect.getdoc(PUBLIC[name]) or ""
    if not has_example(text):
        return
    for package in ("pandas", "polars", "xarray"):
        if name.endswith(package):
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    shutil.copy(CAR_DBC, tmp_path)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    test = doctest.DocTestParser().get_doctest(text, {"np": np, "canser": canser}, name, name, 0)
    report: list[str] = []
    doctest.DocTestRunner(optionflags=flags, verbose=False).run(test, out=report.append)
    assert not report, "".join(report)
