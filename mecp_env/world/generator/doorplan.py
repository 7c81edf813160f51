"""Doors: one for each edge of a spanning tree of the rooms, and one more for each loop."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.world.generator.partition import Point, Space
from mecp_env.world.generator.spec import GeneratorSpec, Rejected
from mecp_env.world.generator.walls import Shared

ANY = 1000  # doors of a corridor
POST_M = 0.35  # of straight wall beside a door, at least


class Opening(NamedTuple):
    """A door of the plan."""

    centre: Point
    width: float  # m
    rooms: tuple[int, int]
    heading: float  # rad, heading from the first room to the second


def plan_doors(
    spaces: list[Space], stretches: list[Shared], thickness: float, spec: GeneratorSpec, rng: np.random.Generator
) -> list[Opening]:
    """rooms - 1 + loops doors that join all rooms, no two between the same rooms. Raises `Rejected`."""
    widths = rng.uniform(*spec.door_width_m, spec.rooms - 1 + spec.loops)
    places = _places(stretches, float(widths.max()) + 2.0 * POST_M + thickness)
    pairs = _chosen(list(places), spaces, spec, rng)
    return [_opening(places[pair], float(width), thickness, rng) for pair, width in zip(pairs, widths, strict=True)]


def _places(stretches: list[Shared], least: float) -> dict[tuple[int, int], Shared]:
    """The longest stretch of wall between each two rooms, where a door fits into it."""
    places: dict[tuple[int, int], Shared] = {}
    for stretch in stretches:
        length, pair = stretch.high - stretch.low, (min(stretch.rooms), max(stretch.rooms))
        if length >= least and (pair not in places or length > places[pair].high - places[pair].low):
            places[pair] = stretch
    return places


def _chosen(
    pairs: list[tuple[int, int]], spaces: list[Space], spec: GeneratorSpec, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Pairs of rooms with a door: first a tree in random order that prefers corridors, then the loops."""
    corridor = np.array([space.corridor for space in spaces])
    order = rng.random(len(pairs)) - 0.5 * corridor[np.array(pairs, np.int64).reshape(-1, 2)].sum(axis=1)
    ranked = [pairs[i] for i in np.argsort(order, kind="stable").tolist()]
    most = np.where(corridor, ANY, spec.max_doors).tolist()
    tree = _tree(ranked, most)
    loops = [pair for pair in ranked if pair not in tree and _take(pair, most)]
    if len(tree) < spec.rooms - 1:
        raise Rejected("rooms")
    if len(loops) < spec.loops:
        raise Rejected("loops", len(loops))
    return tree + loops[: spec.loops]


def _tree(ranked: list[tuple[int, int]], most: list[int]) -> list[tuple[int, int]]:
    """The first pairs that join all rooms; `most` is what is left of the doors that each room may have, in place."""
    group = list(range(len(most)))
    tree = []
    for a, b in ranked:
        if group[a] != group[b] and _take((a, b), most):
            tree.append((a, b))
            group = [group[a] if g == group[b] else g for g in group]
    return tree


def _take(pair: tuple[int, int], most: list[int]) -> bool:
    """Use up one door of either room, in place; False where one of them may have no more."""
    a, b = pair
    if min(most[a], most[b]) < 1:
        return False
    most[a], most[b] = most[a] - 1, most[b] - 1
    return True


def _opening(stretch: Shared, width: float, thickness: float, rng: np.random.Generator) -> Opening:
    """A door anywhere in a part of wall that leaves a jamb on both sides."""
    margin = width / 2.0 + POST_M + thickness / 2.0
    along = float(rng.uniform(stretch.low + margin, stretch.high - margin))
    centre = (stretch.at, along) if stretch.vertical else (along, stretch.at)
    return Opening(centre, width, stretch.rooms, 0.0 if stretch.vertical else math.pi / 2.0)
