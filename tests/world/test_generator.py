"""Generated buildings match their specification, for every seed."""

import json
import math
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import shapely
from scipy.spatial import cKDTree
from shapely.geometry import LineString, Polygon

from mecp_env.core.errors import ConfigError
from mecp_env.world.config import SPLITS, GeneratorSpec, split_seed
from mecp_env.world.doors import building_figures
from mecp_env.world.generator import generate
from mecp_env.world.layout import check_geometry, load_layout
from mecp_env.world.outline import Outline, obstacle_shape
from mecp_env.world.schema import Layout
from tests.world.make import jambs_of

CORNERS_APART_M = 0.25
VERTICES = {"L": 6, "U": 8, "T": 8}


def check(spec: GeneratorSpec, layout: Layout) -> None:
    """All promises of a specification. `check_geometry` proves that every room, door and start is reachable."""
    outline = check_geometry(layout)
    names = Counter(room.name.split()[0] for room in layout.rooms)
    assert (names["corridor"], names.total()) == (spec.corridors, spec.rooms)
    pairs = {frozenset(door.rooms) for door in layout.doors}
    assert len(layout.doors) == len(pairs) == spec.rooms - 1 + spec.loops
    doors_of = Counter(name for door in layout.doors for name in door.rooms if name.startswith("room"))
    assert max(doors_of.values()) <= spec.max_doors
    assert all(spec.door_width_m[0] <= door.width_m <= spec.door_width_m[1] for door in layout.doors)
    (thickness,) = {wall.thickness_m for wall in layout.walls}
    assert spec.wall_thickness_m[0] <= thickness <= spec.wall_thickness_m[1]
    assert all(Polygon(room.polygon).exterior.is_ccw for room in layout.rooms)
    shaped = [room for room in layout.rooms if len(room.polygon) - slants(room.polygon, layout) >= 6]
    assert len(shaped) == spec.shaped_rooms
    assert sum(slants(room.polygon, layout) for room in layout.rooms) == spec.slanted_corners
    check_furniture(spec, layout)
    check_corners(outline)


def slants(ring: Sequence[tuple[float, float]], layout: Layout) -> int:
    """How many edges of a room do not go along or square to the longest wall of the building."""
    pairs = [pair for wall in layout.walls for pair in pairwise(wall.points)]
    (x0, y0), (x1, y1) = max(pairs, key=lambda pair: math.dist(*pair))
    edges = np.roll(np.array(ring), -1, axis=0) - np.array(ring)
    return int((np.abs(np.sin(2.0 * (np.arctan2(*edges.T[::-1]) - math.atan2(y1 - y0, x1 - x0)))) > 1e-3).sum())


def check_furniture(spec: GeneratorSpec, layout: Layout) -> None:
    """As many pieces as declared, of the kinds that may be: within 15 %, or the nearest whole piece."""
    area = sum(Polygon(room.polygon).area for room in layout.rooms if room.name.startswith("room"))
    wanted = spec.furniture * area / 10.0
    assert min(round(wanted), 0.85 * wanted) <= len(layout.obstacles) <= wanted + 0.5 + 1e-9
    shapes = np.array([obstacle_shape(piece) for piece in layout.obstacles], dtype=np.object_)
    middles = shapely.centroid(shapes)
    for room in layout.rooms:
        inside = shapes[shapely.contains(Polygon(room.polygon), middles)]
        a, b = np.triu_indices(len(inside), 1)
        assert shapely.distance(inside[a], inside[b]).min(initial=1.0) > 0.8 - 1e-6


def check_corners(outline: Outline) -> None:
    """No two corners that see each other nearer than stated, but those of the end of a wall."""
    corners, jamb = outline.corners.p_world, jambs_of(outline).any(axis=0)
    for a, b in cKDTree(corners).query_pairs(CORNERS_APART_M - 1e-6):
        across = outline.free_area.covers(LineString([corners[a], corners[b]]))
        assert (jamb[a] and jamb[b]) or not across
    assert np.linalg.norm(np.diff(outline.segments, axis=1)[:, 0], axis=1).min() > 0.02  # no sliver


@pytest.mark.slow
@pytest.mark.parametrize(("difficulty", "seeds"), [("easy", 80), ("medium", 80), ("hard", 40), ("huge", 4)])
def test_what_is_declared_is_what_comes_out(difficulty: str, seeds: int) -> None:
    spec = GeneratorSpec.preset(difficulty)
    for seed in range(seeds):
        check(spec, generate(spec, seed))


def test_random_specifications_are_kept() -> None:
    rng = np.random.default_rng(3)
    for seed in range(20):
        rooms = int(rng.integers(2, 20))
        corridors = int(rng.integers(0, rooms // 8 + 1))
        spec = GeneratorSpec(
            rooms=rooms,
            corridors=corridors,
            shaped_rooms=int(rng.integers(0, (rooms - corridors) // 3 + 1)),
            loops=int(rng.integers(0, rooms // 5 + 1)),
            yards=int(rng.integers(0, 3)),
            slanted_corners=int(rng.integers(0, 4)),
            turned_deg=(-180.0, 180.0),
            furniture=float(rng.uniform(0.0, 2.0)),
            wall_thickness_m=(0.05, 0.3),
        )
        check(spec, generate(spec, seed))


@pytest.mark.parametrize("shape", VERTICES)
def test_a_shape_that_is_asked_for_is_there(shape: str) -> None:
    spec = GeneratorSpec(rooms=6, shaped_rooms=1, shapes=(shape,))
    for seed in range(5):
        rings = [Polygon(room.polygon) for room in generate(spec, seed).rooms]
        shaped = [ring for ring in rings if len(ring.exterior.coords) - 1 >= 6]
        notches = shapely.get_parts(shaped[0].convex_hull.difference(shaped[0]).buffer(-0.01))
        assert len(shaped[0].exterior.coords) - 1 == VERTICES[shape]
        assert len(notches) == (2 if shape == "T" else 1)


def test_a_seed_is_a_building_which_survives_its_file() -> None:
    assert generate(seed=5).to_json() == generate(GeneratorSpec(), 5).to_json() == generate({"rooms": 8}, 5).to_json()
    assert generate(seed=5).to_json() != generate(seed=6).to_json()
    assert generate({"rooms": 2}, 2**128 - 1).name == f"rooms-2-{2**128 - 1}"
    layout = generate(GeneratorSpec.preset("hard"), 3)
    assert load_layout(json.loads(layout.to_json())) == layout
    assert GeneratorSpec(door_width_m=0.8) == GeneratorSpec(door_width_m=(0.8, 0.8))  # a value is a range
    assert GeneratorSpec(pieces="shelf", shapes="L") == GeneratorSpec(pieces=("shelf",), shapes=("L",))
    seeds = [set(SPLITS[split]) for split in ("train", "validation", "test")]
    assert len(set.union(*seeds)) == sum(map(len, seeds))  # the splits share no building
    assert split_seed("test", 0) == 2_000_000


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"rooms": 201}, "rooms"),
    ({"shaped_rooms": 2, "rooms": 3}, "shaped_rooms"),
    ({"corridors": 2, "rooms": 4}, "corridors"),
    ({"turned_deg": (10.0, -10.0)}, "turned_deg"),
    ({"furniture": float("nan")}, "furniture"),
    ({"pieces": ()}, "pieces"),
    ({"lops": 1}, r"lops.*did you mean"),
    ({"door_width_m": (0.9,)}, "door_width_m: a number or a range of two"),
    ({"door_width_m": (0.9, 1.9)}, r"door_width_m: up to 1\.9 m is too wide"),
    ({"loops": 9}, r"loops: 9 loops, at most \d came about in 100 tries"),
    ({"max_doors": 1}, "max_doors: 1, too few to join 8 rooms"),
    ({"furniture": 3.0, "room_side_m": 3.5, "pieces": "box"}, r"furniture: 3 pieces on 10 m2, at most [12]\.\d\d"),
    ({"rooms": 60, "furniture": 2.5, "room_side_m": 12.0, "pieces": "round_pillar"}, "faces, at most 20000"),
]


def test_a_wrong_field_what_no_building_can_be_and_what_is_no_seed_are_named() -> None:
    for fields, said in WRONG:
        with pytest.raises(ConfigError, match=said):
            generate(fields)
    for seed in (-1, "1", 1.0, True, 2**128):
        with pytest.raises(ConfigError, match=r"seed: a whole number from 0 .*\(given: "):
            generate({"rooms": 2}, seed)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="1000 buildings"):
        split_seed("test", 1000)


def test_the_figures_of_two_rooms_are_those_counted_by_hand() -> None:
    figures = building_figures(load_layout("two_rooms"))
    assert (figures.rooms, figures.doors, figures.loops, figures.obstacles) == (2, 1, 0, 0)
    assert figures.faces == figures.corners == 12  # four of each room, four of the door's jambs
    assert figures.longest_corridor_m == 0.0
