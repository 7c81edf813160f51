"""The configuration tree of the environment: frozen, validated, unknown names refused, JSON in both directions."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from mecp_env.core.errors import ConfigError, KeywordError
from mecp_env.core.sensors import LaserNoise
from mecp_env.core.settings import Names, PresetSettings, Settings, guess, load_parts, number
from mecp_env.planning.config import PlanningConfig
from mecp_env.slam.config import SlamConfig
from mecp_env.world.config import ClutterConfig, CrowdConfig, LaserConfig, OdometryConfig, RobotConfig

REWARDS = Names(  # `register_reward` adds others
    *("coverage", "correct_coverage", "contact_share", "lost_share", "shaping", "pace"),
    *("area", "pose_information", "landmark_information", "contact", "time", "completion", "divergence", "lost"),
    *("expected_area", "entropy", "d_optimality", "a_optimality", "t_optimality"),
)


METRIC_PRESETS = ("coverage", "correct_coverage")  # their return is the metric of that name
_NO_METRIC = {"coverage": 0.0, "contact_share": 0.0, "lost_share": 0.0, "contact": -0.1, "time": -0.005}
REWARD_PRESETS: dict[str, dict[str, float]] = {
    "coverage": {"coverage": 1.0, "correct_coverage": 0.0},
    "correct_coverage": {"coverage": 0.0, "correct_coverage": 1.0},
    "terms": {
        **_NO_METRIC,
        "area": 0.1,
        "pose_information": 0.05,
        "landmark_information": 0.05,
        "completion": 10.0,
        "divergence": -20.0,  # more than the time of a whole episode
    },
    "active_terms": {**_NO_METRIC, "expected_area": 0.1, "divergence": -20.0, "lost": -5.0},
}


def registered(name: str) -> str:
    """`name` if it is that of a registered reward. Raises `ValueError` otherwise."""
    if name in REWARDS.ours:
        raise ValueError(f"{name}: one of ours, which has a field of its own: reward={{{name!r}: weight}}")
    if name not in REWARDS.others:
        load_parts()
    if name not in REWARDS.others:
        known = ", ".join(REWARDS.others) or "none yet"
        raise ValueError(
            f"{name:.80}: not registered by register_reward (registered: {known}){guess(name, REWARDS.others)}; "
            "on the command line, --with MODULE imports a module that registers it"
        )
    return name


class ObservationConfig(Settings):
    """The form of the observation, and its parts that are left out by default (docs/observations.md).

    `observation="flat"` stands for `observation={"format": "flat"}`.
    """

    format: Literal["dict", "flat", "image"] = "dict"  # tables and grids; float32 (n,); uint8 (3,64,64)
    map: bool = False  # a coarse grid, 64 x 64 cells of 0.8 m
    scan: bool = False  # the ranges of the merged beams
    uncertainty: bool = False  # `localisation`, and columns of `goals`: predicted sigmas and gain of information

    @model_validator(mode="after")
    def _only_of_a_dict(self) -> Self:
        for name in ("map", "scan"):
            if getattr(self, name) and self.format != "dict":
                raise ValueError(f"{name}: True, expected False with format {self.format!r}; only 'dict' has this part")
        return self


WORDS = {"observation": "format", "reward": "preset"}  # section -> the field that a word in its place stands for


def as_section(name: str, value: Any) -> Any:
    """The fields that a word stands for, as "flat" for an observation of that format; any other value as it is."""
    return {WORDS[name]: value} if name in WORDS and isinstance(value, str) else value


class RewardConfig(PresetSettings):
    """Weight of each reward term, with the unit of the term next to it (see docs/rewards.md).

    `reward="coverage"` stands for `reward={"preset": "coverage"}`. Under "coverage" and "correct_coverage" the sum of
    an episode's rewards is the metric of that name; "terms" and "active_terms" are sums of weighted terms. Weights
    without a preset stand for "terms".
    """

    PRESETS: ClassVar = REWARD_PRESETS
    FREE: ClassVar = frozenset(
        {"preset", "source", "area_sigma_m", "contact_share", "lost_share", "shaping", "pace", "custom"}
    )

    preset: Literal["coverage", "correct_coverage", "terms", "active_terms"] = "coverage"
    source: Literal["belief", "truth"] = "belief"  # of the area, coverage and correct coverage
    area_sigma_m: float = Field(0.3, gt=0.0)  # the estimated area counts while a wall is drawn at least this well
    coverage: float = 1.0  # per mean coverage over the step limit
    correct_coverage: float = 0.0  # per mean (expected) correct coverage over the step limit
    contact_share: float = -0.1  # per share of the step limit in which the robot touched something
    lost_share: float = -0.1  # per share of the step limit in which the pose is off, by ground truth
    shaping: float = 0.0  # potential-based shaping: nearness of a goal; sums to 0 over an episode
    pace: float = 0.0  # potential-based: floor that is missing costs in each step; a constant over an episode
    area: float = 0.0  # per m^2 newly mapped
    pose_information: float = 0.0  # per nat: increase of -0.5 log det of the pose covariance
    landmark_information: float = 0.0  # per nat: increase of -0.5 log det of a landmark covariance, mean over all
    contact: float = 0.0  # per step in which the robot touched something
    time: float = 0.0  # per step
    completion: float = 0.0  # per 100 m^2 of map, once, when the episode terminates
    divergence: float = 0.0  # once, when the filter diverges
    lost: float = 0.0  # once, when an episode ends while the robot is lost, by ground truth: 1 + misplaced / 20 m^2
    expected_area: float = 0.0  # per m^2 of expected correct area
    entropy: float = 0.0  # per nat m^2 that the grid loses
    d_optimality: float = 0.0  # per nat, as the next two: of pose and landmarks
    a_optimality: float = 0.0
    t_optimality: float = 0.0
    custom: dict[Annotated[str, AfterValidator(registered)], float] = Field({})  # weights of `register_reward` names

    @classmethod
    def completed(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """`given`, with the preset that weights without one stand for."""
        weights = "preset" not in given and any(name in REWARDS.ours and name not in cls.FREE for name in given)
        return {"preset": "terms", **given} if weights else given

    @model_validator(mode="after")
    def _of_one_kind(self) -> Self:
        """Refuse weights with which the return would not be the metric that the preset names."""
        preset = self.PRESETS[self.preset]
        for name in sorted(self.model_fields_set - self.FREE) if self.preset in METRIC_PRESETS else ():
            if getattr(self, name) != preset.get(name, 0.0):
                raise ValueError(
                    f"{name}: {getattr(self, name):g} contradicts the preset {self.preset!r}, whose return is that "
                    "metric; the preset 'terms' takes any weights"
                )
        return self


class EndConfig(Settings):
    """When an episode ends before its limit; without a coverage it ends when no goal is left in the estimate."""

    coverage: float | None = Field(None, gt=0.0, le=1.0)  # share of the true free area that must have been seen
    quiet_steps: int = Field(25, ge=1, le=10_000)  # with pedestrians, who may hide a door: no goal for this many steps


def plain_value(value: Any) -> Any:
    """`value` as plain data: a configuration or layout as a dict of what was set in it, a path as a string."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "model_dump"):
        return value.model_dump(mode="json", exclude_unset=True)
    return {name: plain_value(item) for name, item in value.items()} if isinstance(value, Mapping) else value


def plain_layout(value: Any) -> Any:
    """As `plain_value`, and tuples as lists at every depth, as a file has them: equal layouts then are equal."""
    value = plain_value(value)
    if isinstance(value, Mapping):
        return {name: plain_layout(item) for name, item in value.items()}
    return [plain_layout(item) for item in value] if isinstance(value, list | tuple) else value


Number = Annotated[float, BeforeValidator(number)]
S = TypeVar("S", bound=Settings)


class EnvConfig(Settings):
    """The whole environment; every field may be given to `gymnasium.make` as a keyword."""

    layout: Annotated[str | dict[str, Any], BeforeValidator(plain_layout)] = "two_rooms"  # name, path, `Layout` or dict
    estimator: Literal["slam", "known", "truth"] = "slam"
    actions: Literal["velocity", "discrete", "goal"] = "velocity"
    max_steps: int = Field(3000, ge=1, le=10_000_000)
    start: Literal["layout", "random"] | tuple[Number, Number, Number] = "layout"  # or x, y (m), heading (rad), world
    robot: RobotConfig = RobotConfig()
    laser: LaserConfig = LaserConfig()
    odometry: OdometryConfig = OdometryConfig()
    crowd: CrowdConfig = CrowdConfig()
    clutter: ClutterConfig = ClutterConfig()
    slam: SlamConfig = SlamConfig()
    planning: PlanningConfig = PlanningConfig()
    goal_steps: int = Field(10, ge=1, le=1000)  # goals are looked for at most this often (1: every step)
    observation: Annotated[ObservationConfig, BeforeValidator(partial(as_section, "observation"))] = ObservationConfig()
    reward: Annotated[RewardConfig, BeforeValidator(partial(as_section, "reward"))] = RewardConfig()
    end: EndConfig = EndConfig()
    info_texts: bool = True  # without, `info` has numbers alone, as TorchRL's `GymEnv(id, num_envs=n)` needs

    @classmethod
    def build(cls, config: Self | Mapping[str, Any] | None = None, **keywords: Any) -> Self:
        """The configuration from `config` (an `EnvConfig`, a dict or None), overridden by keywords.

        Sections are merged field by field. Raises `ConfigError` for an unknown name at any level (with the closest
        match), a wrong type or a value out of bounds; for an unknown keyword `KeywordError`.
        """
        refuse_keywords(keywords, (), cls.__name__)
        return cls(**merge(plain(config), {name: plain_value(value) for name, value in keywords.items()}))

    @classmethod
    def paper(cls, **keywords: Any) -> Self:
        """The whole pipeline as in the text of the paper (2010), in one switch; keywords override it.

        `SlamConfig.paper()` disables every deviation of the estimator. The laser has the noise of section IV on every
        beam; `laser={"preset": "ideal"}` is the other reading, in which only the filter assumes it. Its burst of sweeps
        is the paper's dense scan (III-A.1).
        """
        return cls.build({"laser": {"preset": "paper"}, "slam": SlamConfig.paper()}, **keywords)

    @property
    def followed(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Section and part of it -> the fields of the part that follow from other sections unless they are set."""
        robot, odometry, laser = self.robot, self.odometry, self.laser
        return {
            ("slam", "sensor"): {name: getattr(laser, name) for name in LaserNoise.model_fields},
            ("planning", "paths"): {"radius_m": robot.radius_m},
            ("planning", "control"): {
                "speed_m_s": robot.max_speed_m_s,
                "turn_rad_s": robot.max_turn_rad_s,
                "acceleration_m_s2": robot.max_acceleration_m_s2,
                "period_s": robot.period_s,
            },
            ("planning", "prediction"): {
                "distance_sigma_m": odometry.scale * odometry.distance_sigma_m,
                "turn_sigma_deg": odometry.scale * odometry.turn_sigma_deg,
                "turn_m": odometry.turn_m,
                "max_range_m": laser.max_range_m,
                "field_of_view_deg": laser.field_of_view_deg,
            },
        }

    def _followed_by(self, name: str, section: S) -> S:
        """A section with what follows from others."""
        parts = dict[str, Any]()
        for (_, part), values in (item for item in self.followed.items() if item[0][0] == name):
            given: Settings = getattr(section, part)
            free = {field: value for field, value in values.items() if field not in given.model_fields_set}
            parts[part] = given.model_copy(update=free)
        return section.model_copy(update=parts)

    @property
    def estimator_config(self) -> SlamConfig:
        """`slam` for the estimator: the sensor follows the laser unless set, "known" merges no landmarks."""
        slam = self._followed_by("slam", self.slam)
        if self.estimator != "known":
            return slam
        known = slam.association.model_copy(update={"method": "known"})
        return slam.model_copy(update={"association": known, "tracks": slam.tracks.model_copy(update={"merge": False})})

    @property
    def planning_config(self) -> PlanningConfig:
        """`planning` for the planner: size and limits follow the robot unless set."""
        return self._followed_by("planning", self.planning)

    @model_validator(mode="after")
    def _can_explore(self) -> Self:
        """Refuse what ends every exploration before it begins."""
        slam, paths = self.slam, self.planning_config.paths
        at_most("slam.grid.resolution_m", slam.grid.resolution_m, 2.0 * paths.radius_m, "the robot's width")
        out, bound = math.hypot(self.laser.x_m, self.laser.y_m), ON_ROBOT * self.robot.radius_m
        at_most("laser: hypot(x_m, y_m)", out, bound, f"{ON_ROBOT} robot.radius_m")
        width = 2.0 * (paths.radius_m + paths.margin_m)
        at_most("2 (planning.paths.radius_m + margin_m)", width, slam.corners.door_width_m[1], "the widest door")
        least = 4 * slam.segments.min_beams
        if self.laser.beams < least:
            raise ValueError(
                f"laser.beams: {self.laser.beams}, at least {least} (slam.segments.min_beams on each of four walls)"
            )
        return self

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON data from which `build` makes an equal configuration.

        It lacks unset values that follow from another section or a preset, so that they do.
        """
        data: dict[str, Any] = self.model_dump(mode="json")
        for (outer, inner), values in self.followed.items():
            for name in values.keys() - getattr(getattr(self, outer), inner).model_fields_set:
                del data[outer][inner][name]
        for outer, section in self:
            if isinstance(section, PresetSettings):
                data[outer] = section.model_dump(mode="json", include={"preset", *section.model_fields_set})
        return data

    def to_json(self) -> str:
        """`to_dict` as text."""
        return json.dumps(self.to_dict(), indent=2)


def at_most(field: str, value: float, bound: float, what: str) -> None:
    """Raise `ValueError` for a value above its bound."""
    if value > bound:
        raise ValueError(f"{field}: {value:g} m, at most {bound:g} m, {what}")


ON_ROBOT = 0.9  # of the robot's radius: how far out a laser may sit, so that no wall comes up to it


def plain(config: Any) -> dict[str, Any]:
    """The fields of a configuration given as an object, a dict or None."""
    if config is None:
        return {}
    if not isinstance(config, Mapping | EnvConfig):
        raise ConfigError(f"config: expected a dict, EnvConfig or None, given {type(config).__name__}")
    fields = plain_value(config)
    assert isinstance(fields, dict)
    return fields


def merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """`below` overridden by `above`, section by section; a layout is one value, not a section."""
    merged = {name: as_section(name, value) for name, value in below.items()}
    for name, value in above.items():
        value = as_section(name, value)
        both = isinstance(value, dict) and isinstance(merged.get(name), dict) and name != "layout"
        merged[name] = merge(merged[name], value) if both else value
    return merged


def refuse_keywords(keywords: Iterable[str], others: Iterable[str], where: str) -> None:
    """Raise `KeywordError` for the first keyword that is neither a field of `EnvConfig` nor one of `others`.

    The message begins with Python's own, on which libraries rely that try keywords.
    """
    known = [*others, *EnvConfig.model_fields, "config"]
    for name in keywords:
        if name not in known:
            hint = "; `reset` takes it" if name in ("seed", "options") else alternatives(name, known)
            raise KeywordError(f"{where}() got an unexpected keyword argument {name!r}{hint}")


def alternatives(name: object, known: Sequence[str]) -> str:
    """The known name that is nearest to an unknown one, and all of them."""
    return f"{guess(name, known)} (fields: {', '.join(known)})"
