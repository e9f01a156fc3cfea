"""The command `canser`: its parser, its signals, its exit codes."""

import argparse
import contextlib
import signal
import sys
from collections.abc import Container, Iterator, Sequence
from importlib import import_module
from typing import Any, Final, NoReturn

import canser
from canser._output import optional_messages
from canser._protocols import protocols
from canser.commands import COMMANDS
from canser.commands._parser import (
    BAD_CALL,
    BAD_DATA,
    GOOD,
    CallError,
    DataError,
    Parser,
    show,
    write_line,
)
from canser.errors import (
    CanserError,
    PortBusyError,
    PortDeniedError,
    PortNotFoundError,
    ReaderGoneError,
    StreamClosedError,
)

__all__ = ["completion", "main", "parser"]


# The metavars of arguments that are names of files; a shell completes these names.
_FILES: Final = ("IN", "OUT", "FILE", "A", "B", "DB")


class _Version(argparse.Action):
    """Print the version; to find it takes long, so it is looked up only here."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:  # noqa: A002
        super().__init__(option_strings, dest, nargs=0, help=help)

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        show([f"canser {canser.__version__}"])
        parser.exit()


class _Completion(argparse.Action):
    """Print a script that completes the command in a shell."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:  # noqa: A002
        super().__init__(
            option_strings, dest, choices=("bash", "zsh", "tcsh"), metavar="SHELL", help=help
        )

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,  # noqa: ARG002 - as argparse calls it
        values: Any,
        option: str | None = None,  # noqa: ARG002
    ) -> NoReturn:
        show(completion(values).splitlines())
        parser.exit()


def completion(shell: str) -> str:
    """Return the script that completes the command in bash, zsh or tcsh."""
    try:
        import shtab  # noqa: PLC0415 - an optional extra
    except ModuleNotFoundError:
        raise CallError("completion needs shtab: pip install 'canser[completion]'") from None
    whole = parser(COMMANDS)
    for action in whole._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                for each in command._actions:
                    if each.metavar in _FILES:
                        setattr(each, "complete", shtab.FILE)  # noqa: B010 - argparse has no such field
    return str(shtab.complete(whole, shell))


def parser(names: Container[str]) -> argparse.ArgumentParser:
    """Return the parser, with the arguments of the commands in `names` only.

    Loading all commands would take longer than most calls of one command.
    """
    whole = Parser(
        prog="canser",
        description="Decode, encode, record and simulate the byte streams of serial CAN adapters.",
        epilog="examples:\n"
        "  canser info run.bin                            # its protocol and frames\n"
        "  canser convert run.bin run.log -p seeed        # raw bytes to a candump log\n"
        "  canser convert run.log run.bin -p serial       # and back to raw bytes\n"
        "  canser dump run.bin -p seeed --filter 123:7FF | head\n"
        "  canser log -c /dev/ttyUSB0 -p seeed run.pcapng # record a port\n"
        "  canser monitor -c /dev/ttyUSB0 -p seeed        # watch a port\n"
        "  canser simulate -p seeed                       # simulate an adapter\n\n"
        f"protocols: {', '.join(protocols())}\n"
        "exit codes: 0 success, 1 the data is bad, 2 the call is wrong",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action=_Version, help="show the version and exit")
    whole.add_argument(
        "--print-completion",
        action=_Completion,
        help="print a script that completes commands and options in SHELL: bash, zsh or tcsh",
    )
    commands = whole.add_subparsers(dest="command", metavar="COMMAND")
    for name, about in COMMANDS.items():
        if name in names:
            import_module(f"canser.commands.{name}").add(commands)
        else:
            commands.add_parser(name, help=about)

    def show_help(_: argparse.Namespace) -> int:
        # The help goes to standard output, so that a pager can read it, as with git. No command
        # was run, so the exit code is not 0: otherwise `canser $COMMAND` in a script would count as
        # a success when the variable is empty.
        show([whole.format_help().rstrip("\n")])
        return BAD_CALL

    whole.set_defaults(run=show_help)  # a command replaces it
    return whole


@contextlib.contextmanager
def _terminated_cleanly() -> Iterator[None]:
    """Let signals raise an exception, so that no half-written file is left behind."""

    def stop(number: int, _: object) -> NoReturn:
        raise SystemExit(128 + number)

    before = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP; nohup ignores it
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            before[number] = signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code, which does not depend on the writing of messages."""
    with optional_messages():
        return _run(sys.argv[1:] if argv is None else argv)


def _run(argv: Sequence[str]) -> int:
    try:
        args = parser(argv).parse_args(argv)
        with _terminated_cleanly():
            code: int = args.run(args)
            return code
    except ReaderGoneError:
        return GOOD  # as in `canser dump ... | head`
    except KeyboardInterrupt:
        write_line("canser: interrupted")
        return 130
    except (
        CallError,
        StreamClosedError,
        FileExistsError,
        FileNotFoundError,
        IsADirectoryError,
        NotADirectoryError,
        PermissionError,
        PortBusyError,
        PortDeniedError,
        PortNotFoundError,
    ) as error:
        return _fail(BAD_CALL, error)
    except (DataError, CanserError, ValueError, OSError) as error:
        return _fail(BAD_DATA, error)
    except RuntimeError as error:
        if "start new thread" not in str(error):
            raise
        return _fail(BAD_DATA, CanserError(f"{error}: allow more with 'ulimit -u'"))


def _fail(code: int, error: Exception) -> int:
    if isinstance(error, OSError) and error.filename is not None:
        text = f"{error.filename}: {error.strerror}"
    else:
        text = str(error)
    # A file name may contain any character, but a message is one line.
    line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    write_line(f"canser: {line}")
    return code
