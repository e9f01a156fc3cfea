"""Whether python-can can find what this package offers it: where that is only on the path, not."""

from importlib.metadata import entry_points

import pytest

needs_installation = pytest.mark.skipif(
    not entry_points(group="can.interface", name="canser"),
    reason="the package is not installed with its entry points; pip install -e . does it",
)
