"""Pictures of a bus, by matplotlib: `pip install 'canser[plot]'`.

Each function draws one picture, and returns a matplotlib figure; nothing is shown on a screen, and
no setting of matplotlib is changed. All pictures share one time axis: without jumps of the clock,
and with the holes of the bus hatched.
"""

from canser.plots._compare import compare
from canser.plots._ids import ids
from canser.plots._load import bus_load
from canser.plots._overview import overview
from canser.plots._payload import payload
from canser.plots._periods import periods
from canser.plots._raster import raster
from canser.plots._signals import signals
from canser.plots._stream import stream

__all__ = [
    "bus_load",
    "compare",
    "ids",
    "overview",
    "payload",
    "periods",
    "raster",
    "signals",
    "stream",
]
