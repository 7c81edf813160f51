"""Active SLAM indoors: Gymnasium environments with EKF-SLAM and MECP data association inside.

Importing this package registers the environments and does nothing else: numba, scipy, pymunk, pygame and matplotlib are
loaded by the first `gymnasium.make`.
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

__version__ = "0.1.0"

LAYOUTS = {"mecp_env/PaperMap-v0": "paper", "mecp_env/Layout-v0": "two_rooms"}


def register_environments() -> None:
    """Register the ids of `LAYOUTS`; a second call changes nothing."""
    for name, layout in LAYOUTS.items():
        if name not in registry:
            register(id=name, entry_point="mecp_env.env:make", kwargs={"layout": layout})


register_environments()
