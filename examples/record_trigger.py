"""Record what surrounds each frame of an id: record_trigger.py URL PROTOCOL ID OUT SECONDS."""

import sys

import canser

url, protocol, arbitration_id, out, seconds = sys.argv[1:]


def report(event: canser.RecorderEvent) -> None:
    """Print files, gaps and triggers as they come."""
    print(event)


canser.record(
    url,
    protocol,
    out,
    triggers=[arbitration_id],
    before=0.5,
    after=0.5,
    duration=float(seconds),
    on_event=report,
)
