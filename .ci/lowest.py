"""Print the lowest allowed version of each package that pyproject.toml names for use and tests: constraints for pip."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

TESTS = ("pytest", "pytest-xdist", "hypothesis")


def constraints(project: dict[str, Any]) -> list[str]:
    """`name==version` for each requirement of the package and of its tests. Raises `ValueError` without a floor."""
    extras = project["optional-dependencies"]["dev"]
    wanted = [*project["dependencies"], *(line for line in extras if re.split("[><=]", line)[0] in TESTS)]
    return [lowest(requirement) for requirement in wanted]


def lowest(requirement: str) -> str:
    """`name>=1.2,<3` as `name==1.2`."""
    found = re.fullmatch(r"([\w-]+)>=([\w.]+)(,<[\w.]+)?", requirement)
    if found is None:
        raise ValueError(f"{requirement!r}: expected name>=version")
    return f"{found[1]}=={found[2]}"


if __name__ == "__main__":
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text()
    print("\n".join(constraints(tomllib.loads(text)["project"])))
