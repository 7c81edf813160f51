"""Documents, layouts and outlines shared by the tests of the world."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest

from mecp_env.world.layout import LIBRARY, load_layout, shipped_layouts
from mecp_env.world.outline import Outline, build_outline

OUTLINES = {name: build_outline(load_layout(name)) for name in shipped_layouts()}
DOCUMENTS = {name: json.loads(Path(LIBRARY / f"{name}.json").read_text()) for name in shipped_layouts()}


@pytest.fixture(params=shipped_layouts())
def outline(request: pytest.FixtureRequest) -> Outline:
    return OUTLINES[request.param]


@pytest.fixture
def paper() -> Outline:
    return OUTLINES["paper"]


@pytest.fixture
def two_rooms() -> Outline:
    return OUTLINES["two_rooms"]


@pytest.fixture
def document() -> dict[str, Any]:
    """A fresh copy of the document of `two_rooms`, for mutation."""
    return copy.deepcopy(DOCUMENTS["two_rooms"])
