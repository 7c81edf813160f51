"""The search for the largest empty convex polygons around a point, against vectors of an exhaustive search."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from mecp_env.slam.mecp.cycles import best_cycles, order_by_bearing, visible_edges

VECTORS = json.loads((Path(__file__).parents[2] / "data" / "empty_convex_polygons.json").read_text())["vectors"]
AROUND = [v for v in VECTORS if v["mode"] == "open" and v["robot"] is not None and not v["robot_on_edge"]]


def largest_around(points, robot, keep, tolerance=0.0):
    """Rings of positions of distinct `points` (n,2), from the least: up to `keep` of the largest around the robot."""
    sites = np.array(points, float).reshape(-1, 2) - robot
    first = np.sort(np.unique(sites, axis=0, return_index=True)[1])
    order = first[order_by_bearing(np.ascontiguousarray(sites[first]))]
    sites = np.ascontiguousarray(sites[order])
    sizes, rings = best_cycles(sites, visible_edges(sites, tolerance), tolerance, keep)
    named = [order[ring[:size]].tolist() for ring, size in zip(rings, sizes, strict=True) if size]
    return [tuple(ring[ring.index(min(ring)) :] + ring[: ring.index(min(ring))]) for ring in named]


@pytest.mark.parametrize("vector", AROUND, ids=lambda vector: vector["name"])
def test_vectors_of_mode_open_hold(vector):
    if vector["robot"] in vector["points"]:  # it blocks every polygon; no corner is seen where the robot is
        assert vector["expected"] == 0
        return
    found = largest_around(vector["points"], vector["robot"], vector["n_optimal"] + 1)
    expected = {tuple(ring) for ring in vector["optimal"]}
    assert len(found) == len(set(found)) == vector["n_optimal"]
    assert {len(ring) for ring in found} == ({vector["expected"]} if found else set())
    assert expected <= set(found) if vector["optimal_truncated"] else expected == set(found)


@pytest.mark.parametrize("turn", np.linspace(0.0, 2 * np.pi, 9))
def test_a_room_may_be_turned(turn):
    c, s = math.cos(turn), math.sin(turn)
    room = np.array([(0, 0), (7, 0), (7, 3), (3, 3), (3, 6), (0, 6)]) @ np.array([[c, s], [-s, c]])
    robot = np.array([1.0, 1.5]) @ np.array([[c, s], [-s, c]])
    assert largest_around(room, robot, 1, 0.01) in ([(0, 3, 4, 5)], [(0, 1, 2, 3)])
