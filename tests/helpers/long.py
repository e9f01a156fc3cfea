"""Tests that take long do a part of their work by default, all of it with CANSER_LONG=1.

`.ci/run` does all of it.
"""

import os
from typing import Final

import pytest

LONG: Final = os.environ.get("CANSER_LONG", "") == "1"

# Examples of Hypothesis for a test: few enough for `make test`, more in CI.
EXAMPLES: Final = 120 if LONG else 80 if os.environ.get("CI") else 30

takes_long: Final = pytest.mark.skipif(not LONG, reason="takes long: CANSER_LONG=1, as in .ci/run")
