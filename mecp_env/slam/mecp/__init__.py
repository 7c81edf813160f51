"""Corners to polygons (III-A.2): search, wall-crossing check, edge labels; the registry of spatial structures."""

from __future__ import annotations

from collections.abc import Callable

from mecp_env.core.carriers import Bools
from mecp_env.slam.config import STRUCTURE_NAMES, PolygonConfig
from mecp_env.slam.custom import check_polygons, maker_of, register
from mecp_env.slam.mecp.polygons import find_largest, find_polygons
from mecp_env.slam.messages import Corners, MergedScan, Polygon

Structure = Callable[[Corners, MergedScan, PolygonConfig, Bools | None], tuple[Polygon, ...]]

STRUCTURES: dict[str, Structure] = {
    "mecp": find_polygons,
    "largest_area": find_largest,
}


def register_structure(name: str, find: Structure) -> None:
    """Let `polygon.structure` name a custom spatial structure, in every configuration that this process reads.

    `find(corners, beams, config.polygon, wall)` returns the polygons of one scan. Corners and beams are in the robot's
    frame, so the robot is the origin; `wall` (B,) marks the beams that end on walls. A built-in name raises
    `ConfigError`; any other may be registered again. Other processes know it if they are forked from this one or import
    what registers it.
    """
    register(STRUCTURE_NAMES, STRUCTURES, name, find)


def find_structure(
    corners: Corners, beams: MergedScan, config: PolygonConfig, wall: Bools | None = None
) -> tuple[Polygon, ...]:
    """The polygons of a scan: those of the structure that `config.structure` names (III-A.2: the MECP).

    Raises `ConfigError` for a custom one that gives anything else.
    """
    found = maker_of(STRUCTURES, config.structure)(corners, beams, config, wall)
    if not config.is_ours:
        check_polygons(config.structure, found, len(corners))
    return found


__all__ = [
    "STRUCTURES",
    "Structure",
    "find_largest",
    "find_polygons",
    "find_structure",
    "register_structure",
]
