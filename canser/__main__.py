"""The program `canser`, also as `python -m canser`: the command, in a process of its own."""

import gc
import sys
from typing import NoReturn

__all__ = ["run"]


def run() -> NoReturn:
    """Run the command with the process's arguments, and end the process with its exit code."""
    # Modules make many objects, and hardly any garbage. Python looks for garbage again and again
    # while they are imported, and among all objects when it ends: an eighth of the time of a short
    # command. The system takes back the memory of a process anyway.
    gc.set_threshold(10_000)
    from canser.commands.cli import main  # noqa: PLC0415 - see above

    try:
        code = main()
    finally:
        gc.freeze()
    sys.exit(code)


if __name__ == "__main__":
    run()
