"""What a user writes at a prompt: type checkers must find nothing here. It is never run."""

from canser import *  # noqa: F403  # pyright: ignore[reportWildcardImportFromLibrary]

traffic: FrameArray = concat([read("run.bin", "seeed"), decode(b"", "seeed")])  # noqa: F405
show(traffic.compress(traffic["ts"] != NO_TIME))  # noqa: F405
