"""Words that we do not use: CONTRIBUTING says why, and which ones we use."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Persons for a part of the code, and private metaphors.
BANNED = (
    *("nobody", "somebody", "anybody", "everybody", "whoever", "whomever"),
    *("tale", "beat", "greeting", "sieve", "stash", "teller", "flaw", "stamper"),
)
PATTERN = re.compile(rf"\b({'|'.join(BANNED)})s?\b", re.IGNORECASE)


def texts() -> Iterator[Path]:
    for folder in ("canser", "csrc", "docs", "bench", "examples"):
        for suffix in ("py", "c", "h", "md", "ipynb"):
            yield from (ROOT / folder).rglob(f"*.{suffix}")
    yield from ROOT.glob("*.md")


@pytest.mark.parametrize("path", sorted(texts()), ids=lambda path: str(path.relative_to(ROOT)))
def test_words_that_stop_a_reader(path: Path) -> None:
    lines = path.read_text(encoding="utf-8").splitlines()
    found = [
        f"{number}: {line.strip()}" for number, line in enumerate(lines, 1) if PATTERN.search(line)
    ]
    assert not found, "\n".join(found)
