"""Tests that take long do a part of their work by default, all of it with CANSER_LONG=1.

`.ci/run` does all of it: the tests of Hypothesis, and those that are marked as long, once more.
"""

import os
from collections.abc import Callable
from typing import Any, Final

import pytest

LONG: Final = os.environ.get("CANSER_LONG", "") == "1"

# Examples of Hypothesis for a test.
EXAMPLES: Final = 120 if LONG else 30

# A test that does more with CANSER_LONG=1.
longer: Final = pytest.mark.long

skipped = pytest.mark.skipif(not LONG, reason="takes long: CANSER_LONG=1, as in .ci/run")


def takes_long(test: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a test that runs with CANSER_LONG=1 only."""
    marked: Callable[..., Any] = longer(skipped(test))
    return marked
