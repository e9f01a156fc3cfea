"""The main job, end to end, without hardware.

For each protocol a virtual adapter sends some seconds of a vehicle's traffic through a pseudo
terminal, as a real one does over its line, but for one byte in a thousand that is lost, added or
flipped. `canser log` records what comes, until the adapter is unplugged; `canser convert`
and `canser info` read the recordings. At the end a table tells what was sent, by the adapters'
own account, and what was found.
"""

import json
import subprocess
import sys
from pathlib import Path

import canser
from canser.recording.reader import Recording

FOLDER = Path("build/demo")
SECONDS = 6

# What `canser log` ends with when the adapter is unplugged.
UNPLUGGED = 1


def command(*arguments: str) -> list[str]:
    """Return the command as it is run here, and show it as it is typed."""
    print(f"$ canser {' '.join(arguments)}", flush=True)
    return [sys.executable, "-m", "canser", *arguments]


def run(*arguments: str) -> None:
    """Run a command."""
    subprocess.run(command(*arguments), check=True)
    print(flush=True)


class Adapter:
    """A virtual adapter, and a recorder at the other end of its terminal."""

    def __init__(self, protocol: str) -> None:
        self.protocol = protocol
        self.recording = FOLDER / f"{protocol}.pcapng"
        self.sent = FOLDER / f"{protocol}.sent.bin"
        self.report = FOLDER / f"{protocol}.json"
        self.complete = False
        simulate = command(
            *("simulate", "-p", protocol, "--seconds", str(SECONDS)),
            *("--noise", "0.001", "--copy", str(self.sent), "--report", str(self.report)),
            "--force",
        )
        self.device = subprocess.Popen(
            simulate, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.device.stdout is not None
        url = self.device.stdout.readline().strip()
        log = command("log", "-c", url, "-p", protocol, str(self.recording), "--force")
        self.recorder = subprocess.Popen(log, stderr=subprocess.PIPE, text=True)

    def finish(self) -> None:
        """Wait until all is sent and recorded, and show what the recorder says."""
        _, complaints = self.device.communicate()
        assert self.device.returncode == 0, complaints
        _, said = self.recorder.communicate()
        print(said)
        assert self.recorder.returncode == UNPLUGGED

    def row(self) -> str:
        """Compare what was sent and what was found."""
        report = json.loads(self.report.read_text())
        with Recording(self.recording) as recording:
            recorded = b"".join(piece.data for piece in recording)
        self.complete = recorded == self.sent.read_bytes()
        with canser.blocks(self.recording) as blocks:
            frames = sum(map(len, blocks))
            stats = blocks.decoder.stats
        return (
            f"{self.protocol:10} {report['bytes_sent']:10,}  "
            f"{'all' if self.complete else 'NOT ALL':8} "
            f"{report['frames']:7,} {report['frames_intact']:7,} {frames:7,} "
            f"{stats.bytes_skipped:8,} {stats.resyncs:8,}"
        )


def main() -> None:
    """Simulate, record, decode, compare, print."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    adapters = [Adapter(protocol) for protocol in canser.protocols()]
    print(f"\n... {SECONDS} seconds of traffic ...\n", flush=True)
    for adapter in adapters:
        adapter.finish()
    for adapter in adapters:
        recording = str(adapter.recording)
        run("convert", recording, recording.replace(".pcapng", ".log"), "--force")
    run("dump", str(FOLDER / "serial.pcapng"), "--filter", "7E0:7FF")
    print("protocol   bytes sent  recorded  frames  intact   found  skipped  resyncs")
    for adapter in adapters:
        print(adapter.row())
    print(
        "\nIntact are the frames that the line left alone. In cantalope and canet13 nothing marks"
        "\na frame's start: after a lost byte wrong frames come out until the scan is back in step."
    )
    print(f"\nThe recordings and logs are in {FOLDER}; try: canser info {FOLDER / 'seeed.pcapng'}")
    if not all(adapter.complete for adapter in adapters):
        sys.exit("what was recorded is not what was sent")


if __name__ == "__main__":
    main()
