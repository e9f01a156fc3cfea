"""Mistakes of a user: type checkers must report each line that ends in a comment for them.

A comment for what is no error is reported itself. It is checked, and never run.
"""

import numpy as np

import canser

frames = canser.read("run.bin", "seeed")

canser.decoed(b"", "seeed")  # type: ignore[attr-defined]  # pyright: ignore[reportAttributeAccessIssue]
canser.read(5)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.decode("text", "seeed")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.decode(b"")  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]
canser.encode(frames, protocol=1)  # type: ignore[call-overload]  # pyright: ignore[reportArgumentType]
canser.concat(5)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.match(frames, 0x123)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.frames(0x123)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.frames(("123", b""))  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.show("123#")  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.Decoder("serial", ts_unit=1)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
canser.Decoder("serial").stats.frames = 1  # type: ignore[misc]  # pyright: ignore[reportAttributeAccessIssue]
canser.open("/dev/ttyUSB0", "seeed", 500_000)  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]
canser.open("/dev/ttyUSB0", "seeed", bitrates=500_000)  # type: ignore[call-arg]  # pyright: ignore[reportCallIssue]
with canser.open("/dev/ttyUSB0", "seeed") as port:
    port.send(0x123)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    port.read_batch(np.empty(5))  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    port.closed = True  # type: ignore[misc]  # pyright: ignore[reportAttributeAccessIssue]
    print(port.clock.offset_ns)  # type: ignore[union-attr]  # pyright: ignore[reportOptionalMemberAccess]
