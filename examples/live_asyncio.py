"""Read a port beside other tasks of asyncio: live_asyncio.py URL PROTOCOL FRAMES."""

import asyncio
import sys

import canser


async def read(url: str, protocol: str, frames: int) -> None:
    """Print each batch, until enough frames have come."""
    count = 0
    with canser.open(url, protocol) as port:
        async for batch in port.batches_async():
            count += len(batch)
            print(f"{count:,} frames")
            if count >= frames:
                return


async def tick() -> None:
    """Do other work meanwhile."""
    while True:
        await asyncio.sleep(0.1)
        print("tick")


async def main(url: str, protocol: str, frames: str) -> None:
    """Run both."""
    other = asyncio.create_task(tick())
    await read(url, protocol, int(frames))
    other.cancel()


asyncio.run(main(*sys.argv[1:]))
