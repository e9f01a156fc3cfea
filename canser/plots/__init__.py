"""Pictures of a bus, by matplotlib: `pip install 'canser[plot]'`.

Each function draws one picture, and returns a matplotlib figure; nothing is shown on a screen, and
no setting of matplotlib is changed. All pictures share one time axis: without jumps of the clock,
and with the holes of the bus hatched.
"""

from canser.plots._load import bus_load
from canser.plots._periods import periods
from canser.plots._raster import raster

__all__ = ["bus_load", "periods", "raster"]
