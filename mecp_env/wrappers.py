"""Wrappers: goal actions, by which a step is a whole drive to a goal; a look at every step; a replay of episodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from mecp_env.core.errors import ConfigError
from mecp_env.env import MecpEnv, Observation
from mecp_env.episode.actions import check_choice, normalised_command
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.planning.goal_list import WAIT, Outcome, RowTimes
from mecp_env.planning.navigator import Navigator, Target
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.shapes import SceneView, summary

Step = tuple[Observation, float, bool, bool, dict[str, Any]]
UNSEEN: Observation = {}  # of a step within a drive
EVENTS = {
    Outcome.RUNNING: "ended",
    Outcome.REACHED: "reached",
    Outcome.REFUSED: "refused",
    Outcome.SETTLED: "reached",
    Outcome.UNLOCALISED: "unlocalised",
}


class GoalActions(gymnasium.Wrapper[Observation, Any, Observation, Any]):
    """Discrete(32): drive to a goal of the observation, with path planner, controller and recovery, until it ends.

    A drive ends when the goal is reached or has nothing more to show, when it is refused (no path, stuck, too long), or
    with the episode. The rewards of its steps are summed. `info["event"]` is "reached", "refused", "ended" (with the
    episode) or "masked", and `info["periods"]` is the number of steps, at least one. A drive after which no goal is
    left is followed by one step of waiting, in which the episode ends (unless nothing was mapped yet; with pedestrians
    or a blind side it ends after several such steps, and a robot with a blind side turns meanwhile).

    Action k drives to the goal in row k of the observation; in "flat", known ground has the last rows.

    `info["action_mask"]` (32,) int8 is 1 in rows that contain a goal, as `action_space.sample(mask=...)` takes it. An
    empty row is "masked": the robot drives to the goal that explores and is nearest in time instead (without one, to
    open floor or a place; then it waits), so that no policy stands still for ever, whatever rows it selects.

    Where `planning.known_ground` offers waiting, its row takes `wait_steps` ("waited"), and a drive also ends when the
    robot no longer knows where it is ("unlocalised").

    `callback`, if set, receives the result of every inner step; where it does not read their observations, `observes`
    may be set to False, and they are empty. A snapshot taken inside a drive continues as a velocity environment: the
    drive itself is not part of it.
    """

    def __init__(self, env: gymnasium.Env[Observation, Any], callback: Callable[[Step], None] | None = None) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, MecpEnv) or env.unwrapped.config.actions == "discrete":
            raise ConfigError("GoalActions: expected a mecp_env environment with actions='goal' or 'velocity'")
        self.base = env.unwrapped
        for name in ("observation_space", "action_space"):  # a drive sends commands to `base`, and shows what it sees
            if getattr(env, name) != getattr(self.base, name):
                raise ConfigError(f"GoalActions: {env} changes the {name}; put that wrapper around GoalActions")
        self.callback, self.observes = callback, True
        own_step = type(self.base).step is not MecpEnv.step  # of a subclass
        self.everything = own_step or self.env is not self.base  # of each step is asked for: others may need it
        self.action_space = spaces.Discrete(GOALS)
        planning = self.base.config.planning_config
        self.navigator, self.times = Navigator(planning), RowTimes.of(planning)

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]
        """The specification; with `actions="goal"` the entry point creates this wrapper."""
        return self.env.spec if self.base.config.actions == "goal" else super().spec

    def action_masks(self) -> NDArray[np.bool_]:
        """(32,) which rows of the observation contain a goal."""
        offered = np.zeros(GOALS, np.bool_)
        offered[self.base.goal_actions[:GOALS]] = True
        return offered

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As of the environment below; `info` has the keys of a step."""
        observation, info = self.env.reset(seed=seed, options=options)
        return observation, info | {"periods": 0, "action_mask": self._mask_in_info()}

    def step(self, action: Any) -> Step:
        """Drive to the goal in row `action`; see the class. Raises `ActionError` for what is no row."""
        chosen = self.base.goal_at(check_choice(action, GOALS))
        if chosen is not None:
            return self._finish(*self._go(chosen))
        best = self.times.best(self.base.goals, GOALS)
        return self._finish([self._wait()] if best is None else self._go(best)[0], "masked")

    def _go(self, row: int) -> tuple[list[Step], str]:
        """The steps of the goal in `row`, and the event that they end with."""
        if self.base.goals.kind[row] == WAIT:
            return self.wait(), "waited"
        steps = self.drive(row)
        if steps and (steps[-1][2] or steps[-1][3]):
            return steps, "ended"
        if not steps or not self.base.goals_left:
            steps.append(self._wait())
        return steps, EVENTS[self.navigator.outcome]

    def _mask_in_info(self) -> NDArray[np.int8]:
        return self.action_masks().astype(np.int8)

    def drive(self, row: int) -> list[Step]:
        """The steps of a drive to the goal in `row`; what became of it is remembered unless the episode ended."""
        goals, steps = self.base.goals, list[Step]()
        self.navigator.start(Target.of(goals, row))
        self.base.aim_at(goals.p_map[row])
        command, was_localised = self.navigator.step(self.base.slam_output), self.base.slam_output.localised
        while self.navigator.outcome == Outcome.RUNNING:
            steps.append(self._step(*command))
            if steps[-1][2] or steps[-1][3]:
                return steps
            if self._gives_up(was_localised):
                self.navigator.outcome = Outcome.UNLOCALISED
                self.base.refresh_goals()
                return steps
            command = self.navigator.step(self.base.slam_output)
        self.base.record_drive(goals, row, self.navigator.outcome)
        return steps

    def _gives_up(self, was_localised: bool) -> bool:
        """True when a drive ends because the pose is searched for, where there are goals for that."""
        offered = self.base.config.planning.known_ground.is_offered
        return offered and was_localised and not self.base.slam_output.localised

    def wait(self) -> list[Step]:
        """The steps of the goal that waits; goals are looked for again after it."""
        steps = list[Step]()
        for _ in range(self.base.config.planning.known_ground.wait_steps):
            steps.append(self._wait())
            if steps[-1][2] or steps[-1][3]:
                return steps
        self.base.refresh_goals()
        return steps

    def _wait(self) -> Step:
        """One step on the spot, in which a robot with a blind side looks around: once before the episode ends."""
        config = self.base.config
        around = 2.0 * math.pi / (config.end.quiet_steps * config.robot.period_s)
        blind = self.base.slam_output.beams.blind
        return self._step(0.0, min(around, config.robot.max_turn_rad_s) if blind else 0.0)

    def _step(self, v: float, w: float) -> Step:
        """One control step with a command in m/s and rad/s; what nobody looks at is not computed."""
        robot = self.base.config.robot
        action = normalised_command(v, w, (robot.max_speed_m_s, robot.max_turn_rad_s))
        if self.everything or (self.callback is not None and self.observes):
            observation, reward, terminated, truncated, info = self.env.step(action)
            step = observation, float(reward), terminated, truncated, info
        else:
            step = UNSEEN, *self.base.advance(action), self.base.info() if self.callback is not None else {}
        if self.callback is not None:
            self.callback(step)
        return step

    def _finish(self, steps: list[Step], event: str) -> Step:
        """One step out of those of a drive: the last one with all rewards, and goals as they are known now."""
        observation, _, terminated, truncated, info = steps[-1]
        if observation is UNSEEN or (event != "ended" and not terminated):
            observation, info = self.base.observation(), info | self.base.info()
        own = {"periods": len(steps), "goals": self.base.goals_left, "action_mask": self._mask_in_info()}
        info = info | own | ({"event": event} if self.base.config.info_texts else {})
        return observation, sum(step[1] for step in steps), terminated, truncated, info


class EveryStep(gymnasium.Wrapper[Observation, Any, Observation, Any]):
    """Call `look(view, info)` after each reset (`info` None) and after every control step, those of drives included.

    Works around any environment of this package; `view` is its `SceneView`. Raises `ConfigError` for another one.
    """

    def __init__(
        self, env: gymnasium.Env[Observation, Any], look: Callable[[SceneView, dict[str, Any] | None], None]
    ) -> None:
        super().__init__(env)
        if not isinstance(env.unwrapped, MecpEnv):
            raise ConfigError(f"{type(self).__name__}: expected a mecp_env environment, got {env}")
        self.base, self.look = env.unwrapped, look
        self.goals = _goal_actions(env)
        if self.goals is not None:
            self.after, self.goals.callback = self.goals.callback, self._drive_step

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """As of the environment below."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.look(self.base.view(), None)
        return observation, info

    def step(self, action: Any) -> Step:
        """As of the environment below."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self.goals is None:
            self.look(self.base.view(), info)
        return observation, float(reward), terminated, truncated, info

    def _drive_step(self, step: Step) -> None:
        self.look(self.base.view(), step[4])
        if self.after is not None:
            self.after(step)


class RecordReplay(EveryStep):
    """Write a page that plays each episode, `FOLDER/episode-0000.html` and so on (`mecp-env replay`).

    Works around any environment of this package, inner steps of goal actions included, in training and evaluation.
    `every`: only each so many-th episode. An episode that is cut off by `reset` or `close` is written, too. Raises
    `ConfigError` for another environment, and `OSError` where the folder cannot be written.
    """

    def __init__(self, env: gymnasium.Env[Observation, Any], folder: str | Path, every: int = 1) -> None:
        super().__init__(env, self._keep)
        if every < 1:
            raise ConfigError(f"RecordReplay: every: expected at least 1, got {every}")
        self.folder, self.every = Path(folder), every
        self.folder.mkdir(parents=True, exist_ok=True)
        self.episode, self.recorder = -1, Recorder()
        self.seen: SceneView | None = None

    def step(self, action: Any) -> Step:
        """As of the environment below."""
        step = super().step(action)
        if step[2] or step[3]:
            self._write()
        return step

    def close(self) -> None:
        """Write what there is of the last episode."""
        self._write()
        super().close()

    def _keep(self, view: SceneView, info: dict[str, Any] | None) -> None:
        if info is None:
            self._write()
            self.episode, self.recorder = self.episode + 1, Recorder(self.base.config.robot.period_s)
        if self.episode % self.every == 0:
            self.recorder.look(view, info)
        self.seen = view

    def _write(self) -> None:
        if self.seen is not None and len(self.recorder.frames) > 1:
            title = f"{self.seen.title.partition(', step')[0]}, episode {self.episode}"
            result = ", ".join(f"{name} {value}" for name, value in summary(self.seen.metrics))
            write_page(self.recorder.run(title, result), self.folder / f"episode-{self.episode:04}.html")
        self.recorder = Recorder()


def _goal_actions(env: gymnasium.Env[Any, Any]) -> GoalActions | None:
    """The wrapper that drives to goals, if there is one."""
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, GoalActions):
            return env
        env = env.env
    return None
