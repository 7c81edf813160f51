"""Builders of what the world passes on."""

from typing import Any

import numpy as np

from mecp_env.world.outline import GAP_POST_M, Outline, door_ring
from mecp_env.world.simulation import Motion


def motion(*arcs: Any, steps: int = 1, contact: bool = False) -> Motion:
    """Arcs of distance (m) and turn (rad), `steps` times."""
    return Motion(np.array(arcs * steps, float), contact)


def jambs_of(outline: Outline) -> Any:
    """(d,n) which corners are jambs of each door; those of a gap may be a little off."""
    rings = [door_ring(outline.doors, door, 0.0) for door in range(len(outline.doors))]
    far = np.array([np.linalg.norm(outline.corners[:, None] - ring, axis=2).min(axis=1) for ring in rings])
    return far < np.where(outline.doors.gap, GAP_POST_M, 1e-4)[:, None]
