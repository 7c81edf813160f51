"""Documents, layouts and outlines shared by the tests of the world."""

import json
from typing import Any

import pytest

from mecp_env.world.layout import LIBRARY, load_layout, shipped_layouts
from mecp_env.world.outline import Outline, build_outline

OUTLINES = {name: build_outline(load_layout(name)) for name in shipped_layouts()}


def document_of(name: str) -> Any:
    """The JSON of a shipped layout."""
    return json.loads((LIBRARY / f"{name}.json").read_text())


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
def document() -> Any:
    return document_of("two_rooms")
