"""Print the oldest supported release of each package that users install, as pins of pip."""

import tomllib
from itertools import chain
from pathlib import Path

DEVELOPERS = {"bench", "docs", "lint", "test"}

text = Path(__file__).parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8")
project = tomllib.loads(text)["project"]
extras = project["optional-dependencies"]
users = [extras[name] for name in extras.keys() - DEVELOPERS]
for requirement in chain(project["dependencies"], *users):
    if ">=" in requirement:
        print(requirement.replace(">=", "==", 1))
