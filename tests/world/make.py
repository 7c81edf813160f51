"""Builders of what the world passes on."""

from typing import Any

import numpy as np

from mecp_env.world.outline import GAP_POST_M, Outline, door_ring
from mecp_env.world.simulation import Motion


def motion(*arcs: Any, steps: int = 1, contact: bool = False) -> Motion:
    """Arcs of distance (m) and turn (rad), `steps` times."""
    return Motion(np.array(arcs * steps, float), contact)


def jambs_of(outline: Outline) -> Any:
    """(d,n) which corners are jambs of each door: of a gap, the convex ones nearest to its own four."""
    corners, doors = outline.corners, outline.doors
    jambs = np.zeros((len(doors), len(corners)), bool)
    for door, gap in enumerate(doors.gap):
        far = np.linalg.norm(corners.p_world[:, None] - door_ring(doors, door, 0.0), axis=2)
        far[gap & ~corners.convex] = np.inf
        near = far.min(axis=0) < (GAP_POST_M if gap else 1e-4)
        jambs[door, far.argmin(axis=0)[near]] = True
    return jambs
