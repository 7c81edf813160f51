"""One policy in one building, and all that is measured of it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mecp_env.policies.curve import Curve, budget_m
from mecp_env.policies.policy import Agent
from mecp_env.policies.registry import make_agent
from mecp_env.policies.worlds import Env, Info, Look, Setting, admit, masks, rooms

LEVELS = (0.90, 0.99)
COMPLETE_COVERAGE = 0.95
NEVER_BUDGETS = 3.0  # a coverage that is not reached within so many budgets counts as reached there
LEAST_LOG_DET = -60.0  # of a pose covariance that is not positive: the exact one of estimator="truth"


@dataclass(frozen=True, slots=True)
class Task:
    """An episode to be played; the building's number is also the seed of start, noise and policy."""

    policy: str
    building: int
    setting: Setting
    trust: bool = False  # load a model file that may run any code

    def __str__(self) -> str:
        where = f"{self.setting.difficulty}, split {self.setting.split}, building and seed {self.building}"
        return f"policy {self.policy}, {where}, estimator {self.setting.estimator}"


@dataclass(frozen=True, slots=True, eq=False)
class Episode:
    """What came of a task: figures that follow from the seed alone, and the time that the policy took."""

    task: Task
    curve: Curve
    figures: dict[str, float]
    act_s: float  # processor time in `act`


@dataclass(slots=True, eq=False)
class Log:
    """What is noted every step."""

    curve: Curve = field(default_factory=Curve)
    pose_errors_m: list[float] = field(default_factory=list)
    log_dets: list[float] = field(default_factory=list)

    def look(self, observation: dict[str, Any], info: Info) -> None:
        """Take in one control step."""
        self.curve.add(info["metres"], info["period"], info["coverage"])
        self.pose_errors_m.append(info["pose_error_m"])
        self.log_dets.append(log_det(observation["pose_cov"]))


@dataclass(slots=True)
class End:
    """How an episode ended, and what the policy did in it."""

    terminated: bool = False
    diverged: bool = False
    decisions: int = 0
    act_s: float = 0.0


def play(task: Task) -> Episode:
    """Play one episode; the same task gives the same figures bit for bit."""
    agent, log = make_agent(task.policy, task.trust), Log()
    env = admit(rooms(task.setting, agent), agent, log.look)
    end = drive(env, agent, log.look, task.building)
    final: dict[str, float] = env.get_wrapper_attr("summary")()
    env.close()
    return Episode(task, log.curve, measure(log, end, final, task.setting.max_steps), end.act_s)


def drive(env: Env, agent: Agent, look: Look, building: int) -> End:
    """Let the agent explore a building until the episode ends; `look` sees the first observation, too."""
    end = End()
    observation, info = env.reset(seed=building, options={"building": building})
    agent.reset(building)
    look(observation, info)
    over = False
    while not over:
        begun = time.thread_time()
        action = agent.act(observation, masks(env))
        end.act_s += time.thread_time() - begun
        end.decisions += 1
        observation, _, end.terminated, truncated, info = env.step(action)
        over = end.terminated or truncated
    end.diverged = bool(info["diverged"])
    return end


def measure(log: Log, end: End, final: dict[str, float], max_steps: int) -> dict[str, float]:
    """The figures of an episode; a coverage never reached counts as the limit (see docs/policies.md)."""
    curve, budget = log.curve, budget_m(final["free_area_m2"])
    figures = {"auc": curve.area_under(budget), "budget_m": budget}
    for level in LEVELS:
        figures[f"reached_{level:.0%}"] = float(curve.metres_to(level, np.inf) < NEVER_BUDGETS * budget)
        figures[f"metres_to_{level:.0%}"] = curve.metres_to(level, NEVER_BUDGETS * budget)
        figures[f"periods_to_{level:.0%}"] = curve.steps_to(level, float(max_steps))
    return figures | {
        "complete": float(is_complete(end, final)),
        "terminated": float(end.terminated),
        "diverged": float(end.diverged),
        "decisions": float(end.decisions),
        "pose_error_mean_m": float(np.mean(log.pose_errors_m)),
        "log_det_mean": float(np.mean(log.log_dets)),
        **{name: float(final[name]) for name in KEPT},
    }


KEPT = (  # of the environment's own summary
    "coverage",
    "metres",
    "periods",
    "free_area_m2",
    "rooms",
    "rooms_found",
    "doors",
    "doors_found",
    "pose_error_final_m",
    "landmarks",
    "duplicates",
    "contacts",
)


def is_complete(end: End, final: dict[str, float]) -> bool:
    """True when the episode ended by itself with every room and door found and nearly all of the floor seen."""
    found = final["rooms_found"] == final["rooms"] and final["doors_found"] == final["doors"]
    return bool(end.terminated and found and final["coverage"] >= COMPLETE_COVERAGE)


def log_det(pose_cov: Any) -> float:
    """log det of the pose covariance given as xx, xy, x heading, yy, y heading, heading heading (m, rad)."""
    xx, xy, xt, yy, yt, tt = np.asarray(pose_cov, np.float64).tolist()
    det = xx * (yy * tt - yt * yt) - xy * (xy * tt - yt * xt) + xt * (xy * yt - yy * xt)
    return max(float(np.log(det)), LEAST_LOG_DET) if det > 0.0 else LEAST_LOG_DET
