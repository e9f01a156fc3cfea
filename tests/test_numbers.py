"""The numbers of options: what is read, and what other readers of numbers would let pass."""

import argparse
import contextlib
import io
from argparse import ArgumentTypeError
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from canser.commands import COMMANDS, cli
from canser.commands._numbers import byte_count, duration, real, whole

# What int() or float() reads, and is no number by any grammar here.
LOOSE = [
    *("", " ", "1_0", " 1", "1 ", "1\n", "+1", "0x1", "\u0661", "\uff11", "\u00b2", "1\u2003"),
    *("nan", "inf", "-inf", "Infinity", "1,5", "--1", "1e", "e1", ".", "1.0.0", "1" * 5_000 + "_0"),
]


@pytest.mark.parametrize("text", [*LOOSE, "1.0", "1e3", "1" * 5_000])
def test_what_is_no_whole_number(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is no number; write a whole number such as 10"):
        whole()(text)


@pytest.mark.parametrize("text", LOOSE)
def test_what_is_no_number(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is no number; write a number such as"):
        real()(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [("0", 0), ("007", 7), ("-0", 0), ("100000000000000000000", 10**20)],
)
def test_whole_numbers(text: str, value: int) -> None:
    assert whole()(text) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("0", 0), ("1.5", 1.5), ("5.", 5), (".5", 0.5), ("1e-3", 0.001), ("2E+2", 200), ("-0.0", 0)],
)
def test_numbers(text: str, value: float) -> None:
    assert real()(text) == value


@pytest.mark.parametrize(
    ("parse", "text", "reason"),
    [
        (whole(least=1), "0", "0 must be 1 or more"),
        (whole(), "-1", "-1 must be 0 or more"),
        (whole(least=1, most=9), "10", "10 must be 1 to 9"),
        (real(), "-0.1", "-0.1 must be 0 or more"),
        (real(most=1), "1.01", "1.01 must be 0 to 1"),
        (real(above=True), "0", "0 is too small; it must be more than 0"),
        (real(), "1e999", "1e999 is too large"),
    ],
)
def test_a_number_outside_of_its_limits(
    parse: Callable[[str], float], text: str, reason: str
) -> None:
    with pytest.raises(ArgumentTypeError, match=f"^{reason}$"):
        parse(text)


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        *[("500ms", 0.5), ("5", 5), ("5 s", 5), ("1.5s", 1.5), ("10m", 600), ("10min", 600)],
        *[("1h", 3600), ("2d", 172_800), ("100000d", 8_640_000_000), ("0", 0)],
    ],
)
def test_times(text: str, seconds: float) -> None:
    assert duration(text) == seconds


@pytest.mark.parametrize("text", [*LOOSE, "5S", "5 sec", "-5s", "1e3s", "5\u2003s", "5\ts", "1_0s"])
def test_what_is_no_time(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match=r"cannot read the time .*; write 500ms, 5s"):
        duration(text)


@pytest.mark.parametrize("text", ["100001d", "9" * 400, "9" * 5_000 + "ms"])
def test_a_time_that_no_count_of_nanoseconds_holds(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is too long; give 100000d or less"):
        duration(text)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        *[
            ("500k", 500_000),
            ("500KB", 500_000),
            ("100M", 10**8),
            ("1 G", 10**9),
            ("7", 7),
            ("7B", 7),
        ],
        *[("1.5Gi", 3 << 29), ("64MiB", 64 << 20), ("2ki", 2048)],
        # Exactly: as a binary fraction it would be a byte less.
        *[("2.3G", 2_300_000_000), ("0.1M", 100_000)],
    ],
)
def test_sizes(text: str, count: int) -> None:
    assert byte_count(text) == count


@pytest.mark.parametrize("text", [*LOOSE, "5X", "5kk", "1e6", "-5k", "1_0M", "\u0661M", "5\u2003M"])
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match=r"cannot read the size .*; write 500k, 100M"):
        byte_count(text)


def options() -> Iterator[tuple[str, argparse.Action]]:
    """Yield every option of every command that takes a value, with the command's name."""
    whole = cli.parser(COMMANDS)
    (commands,) = (a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    for name, parser in commands.choices.items():
        for action in parser._actions:
            if action.option_strings and action.nargs != 0:
                yield name, action


def test_no_option_reads_numbers_as_python_does() -> None:
    """A type of argparse is one of ours: it takes none of what int() and float() take besides."""
    types: dict[Any, str] = {
        action.type: f"canser {name} {action.option_strings[-1]}" for name, action in options()
    }
    types.pop(None)
    assert len(types) > 10
    for parse, option in types.items():
        for text in ("1_0", " 1", "\u0661", "+1", "nan", "inf", "1_0:1", "1:\u0661", "\uff11s"):
            with pytest.raises(ArgumentTypeError):
                pytest.fail(f"{option} {text!r} gives {parse(text)!r}")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        ("log -c /dev/null -p seeed x.pcapng --keep 1_0", "--keep: '1_0' is no number"),
        ("log -c /dev/null -p seeed x.pcapng --baudrate \u0661", "is no number"),
        ("log -c /dev/null -p seeed x.pcapng --baudrate 2147483648", "must be 1 to 2147483647"),
        ("log -c /dev/null -p seeed x.pcapng --bitrate 500_000", "'500_000' is no number"),
        ("log -c /dev/null -p seeed x.pcapng --adapter-filter 1_0:7FF", "write ID:MASK"),
        ("log -c /dev/null -p seeed x.pcapng --adapter-filter 0x:7FF", "write ID:MASK"),
        ("play x.log -c /dev/null -p seeed --gap 1e12", "must be 0 to 86400000"),
        ("play x.log -c /dev/null -p seeed --speed inf", "'inf' is no number"),
        ("simulate -p seeed --seed 1_0", "'1_0' is no number"),
        ("simulate -p seeed --stall 1_0:1", "'1_0:1' is no stall"),
        ("simulate -p seeed --stall 10:1_0", "'10:1_0' is no stall"),
        ("simulate -p seeed --stall 10:inf", "'10:inf' is no stall"),
    ],
)
def test_an_option_says_what_is_wrong(call: str, words: str) -> None:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), pytest.raises(SystemExit):
        cli.main(call.split())
    assert words in said.getvalue()
