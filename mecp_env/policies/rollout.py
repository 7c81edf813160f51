"""One policy in one building: the environment, the episode, its metrics, and its coverage over metres and steps."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.intervals import budget_m
from mecp_env.core.settings import shown
from mecp_env.episode.observation_arrays import COV_MAX
from mecp_env.policies.registry import Policy, calls_of, ended, make_policy
from mecp_env.policies.setting import Setting

MASKS = "action_masks"
LEVELS = (0.90, 0.99)
SELECTED = ("layout", "estimator", "max_steps")  # fields that no policy selects
COMPLETE_COVERAGE = 0.95
NEVER_BUDGETS = 3.0  # a coverage that is not reached within this many budgets counts as reached there
LEAST_LOG_DET = -60.0  # of a pose covariance that is not positive: the exact pose of estimator="truth"
TRIED_STEPS = 23  # control steps in which a policy is tried before many episodes; prime: a counter shows itself
KEPT = (  # of the environment's own summary
    *("coverage", "correct_coverage", "metres", "periods"),
    *("free_area_m2", "rooms", "rooms_found", "doors", "doors_found"),
    *("pose_error_final_m", "lost", "map_rmse_m", "landmarks", "landmarks_false", "duplicates", "contacts"),
)
OVER_LIMITS = {  # the same under the names that it has there
    "coverage_over_steps": "coverage_over_steps",
    "correct_over_metres": "correct_coverage_over_metres",
    "correct_over_steps": "correct_coverage_over_steps",
}
Info = dict[str, Any]
OnStep = Callable[[Info], None]
See = Callable[[Any], Any]  # from an observation of the environment to that of a policy
Env = gym.Env[Any, Any]


@dataclass(slots=True, eq=False)
class CoverageCurve:
    """The largest coverage so far, at each distance where it grew; a step function."""

    metres: list[float] = field(default_factory=list)
    steps: list[int] = field(default_factory=list)
    coverage: list[float] = field(default_factory=list)

    def add(self, metres: float, step: int, coverage: float) -> None:
        """Add the coverage after a step; only an increase is kept."""
        if not self.coverage or coverage > self.coverage[-1]:
            self.metres.append(metres)
            self.steps.append(step)
            self.coverage.append(coverage)

    def area_under(self, limit_m: float) -> float:
        """Mean coverage over the first `limit_m` metres: (1/L) * integral of C(d) from 0 to L.

        C(d) is the largest coverage that was reached within d metres. After the end of the episode it is constant;
        metres beyond L do not count.
        """
        bounds = np.minimum(np.array([*self.metres, np.inf]), limit_m)
        return float(np.sum(np.array(self.coverage) * np.diff(bounds)) / limit_m)

    def at(self, metres: Array) -> Array:
        """C(d) at some distances (n,), which are not before the first point."""
        rows = np.searchsorted(np.array(self.metres), metres, side="right") - 1
        values: Array = np.array(self.coverage)[rows]
        return values

    def metres_to(self, level: float, otherwise: float) -> float:
        """Metres to a coverage, at most `otherwise`, also where it was never reached (for a restricted mean)."""
        return self._first(self.metres, level, otherwise)

    def steps_to(self, level: float, otherwise: float) -> float:
        """Control steps to a coverage, at most `otherwise`, also where it was never reached."""
        return self._first(self.steps, level, otherwise)

    def _first(self, at: Sequence[float], level: float, otherwise: float) -> float:
        reached = int(np.searchsorted(self.coverage, level))  # coverage only grows
        return float(min([*at[reached : reached + 1], otherwise]))


@dataclass(frozen=True, slots=True)
class EpisodeTask:
    """An episode to run; its number is the seed of start, noise and policy."""

    policy: str
    building: int  # number of the episode, and of its building unless the setting has fewer
    setting: Setting
    trust: bool = False  # load a model file that may run arbitrary code
    checksum: str = ""  # of a policy that is not part of the package
    source: str = ""  # what the policy is made from, where that is not its name

    @property
    def name(self) -> str:
        """Of its result, in the folder of an evaluation of this setting."""
        return f"{self.policy} {self.checksum} {self.setting.estimator} {self.building:06}"

    def __str__(self) -> str:
        where = f"{self.setting.where}, building and seed {self.building}"
        return f"policy {self.policy}, {where}, estimator {self.setting.estimator}"


@dataclass(frozen=True, slots=True, eq=False)
class EpisodeResult:
    """The result of a task: metrics that follow from the seed alone, and the CPU time of the policy."""

    task: EpisodeTask
    curve: CoverageCurve
    figures: dict[str, float]
    act_s: float  # CPU time in `act`


@dataclass(slots=True, eq=False)
class EpisodeLog:
    """What is recorded of an episode, in every control step and in every decision."""

    curve: CoverageCurve = field(default_factory=CoverageCurve)
    pose_errors_m: list[float] = field(default_factory=list)
    log_dets: list[float] = field(default_factory=list)  # of the covariance of the estimated pose
    reward: float = 0.0  # of all steps
    act_s: float = 0.0  # CPU time of the policy
    decisions: int = 0
    masked: int = 0  # of these, rows that were not offered: another goal replaced each
    terminated: bool = False
    diverged: bool = False

    def add_step(self, info: Info, pose_cov: Any) -> None:
        """Record one control step."""
        self.curve.add(info["metres"], info["period"], info["coverage"])
        self.pose_errors_m.append(info["pose_error_m"])
        self.log_dets.append(log_det(pose_cov))
        self.reward += sum(value for name, value in info.items() if name.startswith("reward_"))

    def add_decision(self, act_s: float, step: Any) -> None:
        """Record one action of the policy, and what `step` returned."""
        _, _, self.terminated, _, info = step
        self.act_s += act_s
        self.decisions += 1
        self.masked += info["event"] == "masked"
        self.diverged = info["diverged"]


def run_episode(task: EpisodeTask) -> EpisodeResult:
    """Run one episode; the same task gives the same metrics bit for bit."""
    policy = make_policy(task.source or task.policy, task.trust)
    env = make_rooms(task.setting, policy, task.building)
    log, place = EpisodeLog(), (task.setting.building(task.building), task.building)
    try:
        for _, act_s, step in decisions(env, policy, lambda info: log.add_step(info, pose_cov(env)), place):
            log.add_decision(act_s, step)
    except SystemExit as error:  # which would end the process without a word
        raise ConfigError(f"policy: it ends the process ({ended(error)})") from None
    summary: dict[str, float] = env.get_wrapper_attr("summary")()
    env.close()
    return EpisodeResult(task, log.curve, metrics(log, summary, task.setting.max_steps), log.act_s)


def make_rooms(setting: Setting, policy: Policy, episode: int = 0) -> Env:
    """The buildings of a setting, of a layout that of an episode, with random starts by default. Raises `MecpError`."""
    keywords = {**setting.buildings(episode), **setting.fields(options_of(policy))}
    return gym.make(disable_env_checker=True, **keywords)


def options_of(policy: Policy) -> dict[str, Any]:
    """The fields of the configuration that a policy needs: its actions, and its `settings`.

    Raises `ConfigError` for settings with other actions, that are no fields, or that every evaluation selects.
    """
    name = str(getattr(policy, "name", type(policy).__name__))
    with calls_of(name, "has settings that cannot be read"):
        given, actions = getattr(policy, "settings", {}), policy.actions
    if not isinstance(given, Mapping):
        raise ConfigError(f"policy: {name!r:.80}: settings {shown(given)}, expected a dict of the fields of EnvConfig")
    if given.get("actions", actions) != actions:
        theirs = shown(given["actions"])
        raise ConfigError(f"policy: {name!r:.80}: settings of actions {theirs}, but its `actions` are {shown(actions)}")
    if selected := [field for field in SELECTED if field in given]:
        raise ConfigError(f"policy: {name!r:.80}: settings of {', '.join(selected)}, which the evaluation selects")
    fields = {**given, "actions": actions}
    try:
        EnvConfig.build(fields)
    except ConfigError as error:
        raise ConfigError(f"policy: {name!r:.80}: settings: {error}") from None
    return fields | {"info_texts": True}  # the event of a drive is shown and counted


def first_actions(env: Env, policy: Policy, name: str) -> list[Any]:
    """What a policy does in the beginning of an episode. Raises `ConfigError` that names it where that fails."""
    actions = []
    with calls_of(name):
        for action, _, step in decisions(env, policy, lambda _: None, (0, 0)):
            actions.append(np.array(action))
            if step[4]["period"] >= TRIED_STEPS:
                break
    return actions


def masks_of(env: Env) -> Callable[[], Any]:
    """A function that returns the mask of the goals; None where actions are no goals."""
    found: Callable[[], Any] = env.get_wrapper_attr(MASKS) if env.has_wrapper_attr(MASKS) else lambda: None
    return found


def pose_cov(env: Env) -> Any:
    """(6,) float32: the covariance of the estimated pose, in the order and bounds of the observation's `pose_cov`."""
    cov = env.get_wrapper_attr("slam_output").belief.pose_cov[np.triu_indices(3)]
    return np.clip(cov.astype(np.float32), -COV_MAX, COV_MAX)


def run_policy(
    env: Env, policy: Policy, on_step: OnStep, building_seed: tuple[int, int], see: See = lambda observed: observed
) -> Info:
    """The last info of an episode that a policy plays; see `decisions`."""
    _, _, last = deque(decisions(env, policy, on_step, building_seed, see), maxlen=1)[0]
    return dict(last[4])


def decisions(
    env: Env, policy: Policy, on_step: OnStep, building_seed: tuple[int, int], see: See = lambda observed: observed
) -> Iterator[tuple[Any, float, Any]]:
    """The decisions of an episode: the action, CPU seconds in `act`, and what `step` returned.

    The policy acts on `see(observation)`. `on_step` receives the info of the reset and of every control step, those
    within drives included.
    """
    building, seed = building_seed
    drives = env.has_wrapper_attr("callback")  # of `GoalActions`
    if drives:
        env.set_wrapper_attr("callback", lambda step: on_step(step[4]))
        env.set_wrapper_attr("observes", False)
    observation, info = env.reset(seed=seed, options={"building": building})
    policy.reset(seed)
    on_step(info)
    masks, ended = masks_of(env), False
    while not ended:
        start = time.thread_time()
        action = policy.act(see(observation), masks())
        act_s = time.thread_time() - start
        step = env.step(action)
        if not drives:
            on_step(step[4])
        yield action, act_s, step
        observation, ended = step[0], step[2] or step[3]


def metrics(log: EpisodeLog, summary: dict[str, float], max_steps: int) -> dict[str, float]:
    """The metrics of an episode; a coverage never reached counts as the limit (docs/policies.md)."""
    curve, budget = log.curve, budget_m(summary["free_area_m2"])
    figures = {"auc": curve.area_under(budget), "budget_m": budget}
    figures |= {name: summary[theirs] for name, theirs in OVER_LIMITS.items()}
    for level in LEVELS:
        figures[f"reached_{level:.0%}"] = float(curve.metres_to(level, np.inf) < NEVER_BUDGETS * budget)
        figures[f"metres_to_{level:.0%}"] = curve.metres_to(level, NEVER_BUDGETS * budget)
        figures[f"periods_to_{level:.0%}"] = curve.steps_to(level, float(max_steps))
    return figures | {
        "complete": float(log.terminated and is_complete(summary)),
        "terminated": float(log.terminated),
        "diverged": float(log.diverged),
        "decisions": float(log.decisions),
        "masked": float(log.masked),
        "reward": log.reward,
        "pose_error_mean_m": float(np.mean(log.pose_errors_m)),
        "log_det_mean": float(np.mean(log.log_dets)),
        **{name: float(summary[name]) for name in KEPT},
    }


def is_complete(summary: dict[str, float]) -> bool:
    """True when the robot is not lost, has found all rooms and doors, and has seen 95 % of the floor."""
    found = all(summary[f"{name}_found"] == summary[name] for name in ("rooms", "doors"))
    return bool(not summary["lost"] and found and summary["coverage"] >= COMPLETE_COVERAGE)


def log_det(pose_cov: Any) -> float:
    """log det of the pose covariance given as xx, xy, x heading, yy, y heading, heading heading (m, rad)."""
    xx, xy, xt, yy, yt, tt = np.asarray(pose_cov, np.float64).tolist()
    det = xx * (yy * tt - yt * yt) - xy * (xy * tt - yt * xt) + xt * (xy * yt - yy * xt)
    return max(float(np.log(det)), LEAST_LOG_DET) if det > 0.0 else LEAST_LOG_DET
