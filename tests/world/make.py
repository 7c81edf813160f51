"""Builders of what the world passes on."""

from typing import Any

import numpy as np

from mecp_env.world.simulation import Motion


def motion(*arcs: Any, steps: int = 1, contact: bool = False) -> Motion:
    """Arcs of distance (m) and turn (rad), `steps` times."""
    return Motion(np.array(arcs * steps, float), contact)
