"""Active SLAM indoors: Gymnasium environments with EKF-SLAM and MECP data association inside.

Importing this package registers the environments and does nothing else: numba, scipy, pymunk, pygame and matplotlib are
loaded by the first `gymnasium.make`.
"""

from __future__ import annotations

from mecp_env.core.interrupts import watch_interrupts

watch_interrupts()  # before the imports: Ctrl-C may come while they run

from importlib import import_module  # noqa: E402
from typing import Any  # noqa: E402

from gymnasium.envs.registration import register, registry  # noqa: E402

from mecp_env.core.provenance import __version__ as __version__  # noqa: E402

ENVIRONMENTS = {  # id -> entry point
    "mecp_env/First-v0": "mecp_env.registration:make_first",
    "mecp_env/PaperMap-v0": "mecp_env.registration:make_paper_map",
    "mecp_env/Layout-v0": "mecp_env.registration:make",
    "mecp_env/Rooms-v0": "mecp_env.registration:make_rooms",
    "mecp_env/FloorPlan-v0": "mecp_env.registration:make_floor_plan",
    "mecp_env/ActiveHalls-v0": "mecp_env.registration:make_active_halls",
    "mecp_env/ActiveCorridors-v0": "mecp_env.registration:make_active_corridors",
    "mecp_env/ActiveCheapRobot-v0": "mecp_env.registration:make_active_cheap_robot",
}
TRAINED = {  # suffix of the file of a trained policy, "" for all others -> the function that loads it
    ".onnx": "mecp_env.learning.exported:load_onnx",
    "": "mecp_env.learning.learned:load",
}


def register_environments() -> None:
    """Register the ids of `ENVIRONMENTS`; a second call changes nothing."""
    for name, entry_point in ENVIRONMENTS.items():
        if name not in registry:
            batch = entry_point.replace("registration", "vector")
            register(id=name, entry_point=entry_point, vector_entry_point=batch)


def flat_names(env: Any = None, *, actions: str = "velocity", uncertainty: bool = False) -> tuple[str, ...]:
    """The name of each number of an observation of the format "flat", in its order (docs/observations.md).

    Of an environment that was made with `observation="flat"`, or of one with these `actions` ("velocity", "discrete",
    "goal") and `uncertainty`. Raises `ConfigError` for another environment, and for unknown actions.
    """
    layout = import_module("mecp_env.episode.compact_observations")  # by name: loaded when it is called
    names: tuple[str, ...] = layout.flat_names(env, actions=actions, uncertainty=uncertainty)
    return names


def calibrate(scans: Any, odometry: Any, sensor: Any = None) -> Any:
    """Sensor and odometry models of a robot, from its own scans and the poses by its odometry: no truth is needed.

    `scans`: n scans in order, as the estimator takes them (`mecp_env.slam.Scan`: ranges and bearings (K,B), m and rad).
    `odometry`: (n,3) x, y, heading of the robot at each scan, m and rad, in any fixed frame. `sensor`: what is known of
    the laser, fields of `SensorModel` or a whole one; by default it is centred on the robot and looks ahead.

    The result has `.sensor`, a `SensorModel` with forward offset, heading and range noise of the laser; `.odometry`, an
    `OdometryModel`, whose `between(T_before, T_after)` gives the corrected `Odometry` of a step with its covariance;
    `.estimates` of every field with standard deviations; and `.notes`, which name each default that is used because
    the scans do not tell the value, as in the dark, along a single wall, or with too few scans.

    Raises `SensorError` for an invalid scan, for odometry of another shape or that is not finite, and for odometry that
    never moves or jumps by more than 5 m between two scans; `ConfigError` for an unknown field of the sensor.

    Method: registration of scans from point to line (Censi 2008), a hand-eye equation in the plane for mounting, scale
    and bias, and robust variances for the noise (docs/logs.md).
    """
    return import_module("mecp_env.evaluation.calibration").calibrate(scans, odometry, sensor)


register_environments()
