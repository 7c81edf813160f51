"""Name and unit of every column of the observation, in the order of the arrays (see `Observer`)."""

from __future__ import annotations

from mecp_env.episode.observation_arrays import LAYERS

Column = tuple[str, str]  # name, unit ("" for a number without one)

IN_ROBOT_FRAME: tuple[Column, ...] = (("x, robot frame", "m"), ("y, robot frame", "m"))
GOAL: tuple[Column, ...] = (
    *IN_ROBOT_FRAME,
    ("length of the path", "m"),
    ("size", "m"),
    ("kind: 0 open edge, 1 candidate door, 2 frontier, 3 door, 4 known ground, 5 wait, 6 look", ""),
    ("room, -1 unknown", ""),
    ("level", ""),
    ("visits", ""),
    ("valid", ""),
)
PREDICTED: tuple[Column, ...] = (  # with observation={"uncertainty": True}
    ("predicted sigma of the position on arrival", "m"),
    ("predicted sigma of the heading on arrival", "rad"),
    ("predicted gain of landmark information", "nat"),
)
COLUMNS: dict[str, tuple[Column, ...]] = {
    "budget": (("share of the step limit that is left", ""),),
    "pose": (("x, map frame", "m"), ("y, map frame", "m"), ("cos of the heading", ""), ("sin of the heading", "")),
    "pose_cov": (
        ("xx", "m^2"),
        ("xy", "m^2"),
        ("x heading", "m rad"),
        ("yy", "m^2"),
        ("y heading", "m rad"),
        ("heading heading", "rad^2"),
    ),
    "landmarks": (
        *IN_ROBOT_FRAME,
        ("covariance xx, robot frame", "m^2"),
        ("covariance xy, robot frame", "m^2"),
        ("covariance yy, robot frame", "m^2"),
        ("room, -1 unknown", ""),
        ("kind: 0 line crossing, 1 line end, 2 jamb", ""),
        ("valid", ""),
    ),
    "goals": (*GOAL, *PREDICTED),
    "localisation": (
        ("probability that the position error is below 0.5 m", ""),
        ("localised", ""),
        ("recent share of recognised corners", ""),
    ),
    "grid": tuple((f"{layer}, 255 where a cell has it", "") for layer in LAYERS),
    "map": tuple((f"{layer}, 255 where a cell has it", "") for layer in LAYERS),
    "scan": (("range of a merged beam, the maximum range without a hit", "m"),),
}
