"""The main job, end to end, on captures that this program makes itself.

A simulated adapter sends a minute of a vehicle's traffic in each protocol, over a line
that loses, adds or flips one byte in a thousand. The command `canser` then decodes the
captures; at the end a table says what was sent and what was found.
"""

import subprocess
import sys
from pathlib import Path

import canser
from canser.traffic import line_noise, vehicle

FOLDER = Path("build/demo")
SECONDS = 60


def run(*arguments: str) -> None:
    """Run the command and show it as typed."""
    print(f"$ canser {' '.join(arguments)}", flush=True)
    subprocess.run([sys.executable, "-m", "canser", *arguments], check=True)
    print(flush=True)


def main() -> None:
    """Make, decode, compare, print."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    rows = []
    for protocol in canser.protocols():
        sent = vehicle(SECONDS, extended=protocol != "cantalope")
        capture = FOLDER / f"{protocol}.bin"
        capture.write_bytes(line_noise(canser.encode(sent, protocol)))
        log = capture.with_suffix(".log")
        run("convert", str(capture), str(log), "-p", protocol, "--force")

        decoder = canser.Decoder(protocol)
        frames = decoder.feed(capture.read_bytes())
        decoder.flush()
        rows.append((protocol, sent, frames, decoder.stats))

    run("dump", str(FOLDER / "serial.bin"), "-p", "serial", "--filter", "7E0:7FF")
    print("protocol     sent     found   ids  frames/s    bytes in  skipped  resyncs")
    for protocol, sent, frames, stats in rows:
        ids = len(set(zip(frames["id"].tolist(), frames["ext"].tolist(), strict=True)))
        print(
            f"{protocol:10} {len(sent):7,} {len(frames):9,} {ids:5,} "
            f"{len(frames) / SECONDS:9,.0f} {stats.bytes_in:11,} {stats.bytes_skipped:8,} "
            f"{stats.resyncs:8,}"
        )
    print(
        "\nIn cantalope nothing marks a frame's start: after a lost byte wrong frames come out"
        "\nuntil the chain is back in step, so more are found, and more ids, than were sent."
    )
    print(f"\nThe captures and logs are in {FOLDER}; try: canser info {FOLDER / 'seeed.bin'}")


if __name__ == "__main__":
    main()
