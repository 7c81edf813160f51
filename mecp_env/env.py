"""The environment: simulate, sense, estimate, observe, reward. The maths, drawing and physics are in other modules."""

from __future__ import annotations

import copy
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded

from mecp_env.config import EnvConfig, ObservationConfig, plain_value
from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.errors import ConfigError
from mecp_env.core.sensors import Odometry, Scan
from mecp_env.core.snapshot import decode, encode, generator_data, make_generator
from mecp_env.episode.actions import make_actions
from mecp_env.episode.compact_observations import Flat, Image, best_place_last, most_floor_first
from mecp_env.episode.episode import (
    PARTS,
    STATE_FORMAT,
    STATE_VERSION,
    EpisodeState,
    check_parts,
    check_state,
    goals_key,
    nearest_goal,
)
from mecp_env.episode.observation_arrays import GOALS
from mecp_env.episode.observations import Observer, Seen
from mecp_env.episode.oracle import ORACLES
from mecp_env.episode.potentials import NO_GOALS, RewardInputs
from mecp_env.episode.rewards import Happened, apply_weights, events, measured_terms, new_memory, weights_of
from mecp_env.episode.start import check_seed, parse_options
from mecp_env.episode.true_world import TrueWorld
from mecp_env.evaluation.ground_truth import CELL_M
from mecp_env.evaluation.metrics import EpisodeMetrics, figures
from mecp_env.planning.goal_list import LENGTHS, RowTimes
from mecp_env.planning.goals import Goals, Outcome, complete_rooms, find_goals
from mecp_env.planning.known_ground import Surroundings, offered_goals
from mecp_env.render.shapes import SceneView
from mecp_env.slam.output import SlamOutput
from mecp_env.world.odometry import measure
from mecp_env.world.simulation import Motion

Observation = Any  # a dict of arrays, or one array: `config.observation.format`

SCANS_AT_REST = 3  # III: the first landmarks come from the start pose, before any odometry error
RENDER_MODES = ["human", "rgb_array"]


class MecpEnv(gymnasium.Env[Observation, Any]):
    """An indoor robot that explores a building with its estimated map.

    ## Description

    A circular robot with a differential drive (Pioneer P3-DX) starts in an unknown building. Every step is one control
    step of 0.4 s: the robot moves, odometry and laser measure with noise, and a complete EKF-SLAM with Maximum Empty
    Convex Polygon data association (Kosuru, Pedduri, Krishna, 2010) updates pose, landmarks, rooms, doors and a
    semantic grid. The agent receives this estimate, never ground truth. The map frame is the robot's true pose at
    reset.

    ## Action Space

    - `actions="velocity"`: `Box(-1, 1, (2,), float32)`, fractions of the maximum speed (0.75 m/s) and of the
      maximum turn rate (1.75 rad/s, counter-clockwise).
    - `actions="discrete"`: `Discrete(5)`: stop, forward, back, left, right (turns at half of the maximum rate).
    - `actions="goal"`: `Discrete(32)`, a row of the observation's `goals`; the wrapper `GoalActions` drives there.
      `info["action_mask"]` (32,) int8 is 1 in the valid rows; another row is a drive to the nearest goal that explores.

    An action outside the space raises `ActionError` and leaves the environment unchanged.

    ## Observation Space

    A `Dict` of float32 arrays with fixed shapes (see `Observer` for the columns): `budget` (1,), `pose` (4,),
    `pose_cov` (6,), `landmarks` (128,8), `goals` (32,9), `grid` (8,96,96) uint8; on request `map` (8,64,64) uint8 and
    `scan` (B,), and with `uncertainty`, which the tasks of active SLAM have, `localisation` (3,) and three more columns
    of `goals`. Values beyond their bounds are clipped, and rows beyond the table are omitted; `info["saturated"]`
    counts both.
    `observation="flat"` is one `Box(-1, 1, (n,), float32)` instead, n = 181, or 325 with goal actions (see `Flat`;
    `mecp_env.flat_names` names the columns), `observation="image"` one `Box(0, 255, (3, 64, 64), uint8)` (see `Image`).

    ## Rewards

    The sum of an episode is the mean over the step limit of the mapped share of the floor, in [0, 1], less small
    penalties for contacts and a lost pose; in the tasks of active SLAM, of its expected correct share. `reward="terms"`
    is a sum of weighted terms instead, `reward={"source": "truth"}` measures on ground truth; every term has an entry
    in `info` (`reward_coverage`, ...). docs/rewards.md contains the formulas.

    ## Starting State

    The first start pose of the layout, at rest, with three scans taken. `start="random"` draws a pose in free space,
    `start=[x, y, heading]` fixes one. `reset(options={"start": ...})` overrides it for one episode,
    `reset(options={"building": 12})` selects the generated building, and `reset(options={"difficulty": "hard"})` its
    difficulty, for curricula; a list as `difficulty` of `gymnasium.make` draws one at every reset. Any other option
    raises `ConfigError`.

    ## Episode End

    Terminated: no goal is left in an estimate with at least one polygon (with pedestrians: for 25 steps), or the share
    `end={"coverage": ...}` of the true free area has been seen. Truncated: `max_steps` steps (default 3,000), or the
    filter diverged (`info["diverged"]`).

    ## Arguments

    `config`: an `EnvConfig`, a dict or None; `render_mode`: None, "rgb_array" or "human"; every field of `EnvConfig` as
    a keyword that overrides it (`layout`, `estimator`, `actions`, `max_steps`, `start`, `robot`, `laser`, `odometry`,
    `crowd`, `clutter`, `slam`, `planning`, `goal_steps`, `observation`, `reward`, `end`, `info_texts`).
    `crowd={"people": 4}` adds pedestrians, `clutter` adds boxes to push and closed doors, `laser={"field_of_view_deg":
    180, "x_m": 0.15}` is a laser on the robot's front. `layout` is a layout name, a path, a dict or a `Layout`;
    `PaperMap-v0` has a fixed one, and `Rooms-v0` generates one at every reset from `difficulty`, `split` and the fields
    of `GeneratorSpec`. `EnvConfig.paper()` follows the paper literally. `estimator="known"` uses the true
    correspondences, `"truth"` the true pose. Unknown names, and values with which nothing can be explored, raise
    `ConfigError`.

    ## Vectorized environment

    `gymnasium.make_vec(id, num_envs=n)` runs them in a few worker processes (`mecp_env.vector`), the modes "sync" and
    "async" in Gymnasium's classes, each environment bit for bit as if alone; `info` has fixed keys and shapes.

    ## Version History

    - v0: first release.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": RENDER_MODES,
        "render_fps": 10,
    }

    def __init__(
        self, config: EnvConfig | dict[str, Any] | None = None, render_mode: str | None = None, **keywords: Any
    ) -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise ConfigError(
                f"render_mode: expected one of None, {', '.join(map(repr, RENDER_MODES))}, got {render_mode!r}"
            )
        self.config = EnvConfig.build(config, **keywords)
        self.render_mode = render_mode
        self._true_world = TrueWorld(self.config)
        self._start = self._true_world.check_start(self.config.start)
        self._actions = make_actions(self.config.actions)
        self.action_space = self._actions.space
        self._slam, self._planning = self.config.estimator_config, self.config.planning_config
        self._apart = self.config.observation.format == "flat" and self.config.actions == "goal"  # see `goal_actions`
        self._observer = self._new_observer()
        self.observation_space: spaces.Space[Any] = self._observer.space
        self._oracle = ORACLES[self.config.estimator]
        self._weights = weights_of(self.config.reward)
        self._reward_keys = tuple(f"reward_{name}" for name in self._weights)
        self._terms = dict.fromkeys(self._weights, 0.0)  # of the last step's reward
        self._episode: EpisodeState | None = None
        self._screen: Any = None
        self._window: Any = None
        self._spec: EnvSpec | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """The first observation of a new episode, and its info.

        `options` may contain `start`: "layout", "random", or a pose x, y (m), heading (rad) in the world frame; for
        generated buildings also `building`, an index in the split instead of a random one, and `difficulty`, that of
        this episode. Raises `ConfigError` for any other option, a seed that is not an integer of at least 0, a pose
        that is not free, or a building out of range, and then changes nothing.
        """
        given, seed = parse_options(options), check_seed(seed)
        buildings = self._true_world.choose_buildings(given.get("building"), given.get("difficulty"))
        start = self._true_world.check_start(given.get("start", self._start))
        super().reset(seed=seed)
        self._true_world.begin(buildings, start, self.np_random)
        self._observer = self._new_observer()
        self._begin()
        self._terms = dict.fromkeys(self._weights, 0.0)
        self._show()
        return self.observation(), self.info()

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step: observation, reward, terminated, truncated, info.

        Raises `ActionError` and then changes nothing. Raises `ResetNeeded` before `reset` and after the end.
        """
        result = self.advance(action)
        return self.observation(), *result, self.info()

    def advance(self, action: Any) -> tuple[float, bool, bool]:
        """One control step that nobody looks at: reward, terminated, truncated, as of `step`; raises as that does.

        `observation` and `info` return the rest of what `step` does.
        """
        command = self._actions.command(action)
        episode = self._running()
        with nullcontext() if episode.pipeline.is_ours else self._true_world.undone_on_error(self.np_random):
            motion = self._true_world.drive(command)
            pose = self._true_world.T_world_robot
            episode.slam_output = self._estimate(episode, motion, pose)
        self._find_goals(episode)
        self._compare(episode, motion, pose)
        terminated, truncated = self._ends(episode)
        self._terms = self._rewards(episode, terminated)
        self._show()
        return sum(self._terms.values()), terminated, truncated

    def render(self) -> Any:
        """A frame (H,W,3) uint8 in "rgb_array" mode, else None; the "human" window draws itself."""
        if self.render_mode is None:
            gymnasium.logger.warn('render() without a render_mode: give one to gymnasium.make, e.g. "rgb_array"')
            return None
        return self._paint() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window, if there is one; may be called twice."""
        if self._window is not None:
            self._window.close()
        self._window = None

    def get_state(self) -> dict[str, Any]:
        """The running episode as plain versioned data (numbers, strings, arrays, lists, dicts; no pickle).

        It shares no memory with the environment. Raises `ResetNeeded` before the first `reset`, and `StateError` for a
        custom part with an attribute that is no data.
        """
        if self._episode is None:
            raise ResetNeeded("get_state() before reset()")
        return {
            "format": STATE_FORMAT,
            "version": STATE_VERSION,
            "config": self.config.to_json(),
            "building": self._true_world.building,
            "random": generator_data(self.np_random),
            "seed": self._np_random_seed,
            "simulation": encode(self._true_world.simulation.get_state()),
            "moving": encode(self._true_world.movers.state),
            "episode": encode(self._episode),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue bit for bit from a snapshot of `get_state`, in an environment with the same configuration.

        Gymnasium's wrapper `OrderEnforcing` does not notice it: an environment of `gymnasium.make` that was never reset
        still raises `ResetNeeded` in `step`. Call it after a `reset`, or step `env.unwrapped`.

        Raises `StateError` for damaged data or another version or configuration, and then changes nothing.
        """
        check_state(state, self.config)
        building = self._true_world.building_of(state)
        generator = make_generator(state["random"])
        body, moving, episode = (decode(state[part]) for part in PARTS)
        check_parts(state["seed"], body, moving, episode, self._oracle.make_pipeline(self._slam))
        self._true_world.restore(building, moving, body, episode)
        self._np_random, self._np_random_seed = generator, state["seed"]
        self._observer, self._episode = self._new_observer(), episode
        self._terms = dict.fromkeys(self._weights, 0.0)

    def save_map(self, path: str | Path) -> None:
        """Write the estimator's map into a file that `mecp_env.slam.SlamPipeline.from_map` reads (docs/estimator.md).

        Raises `ResetNeeded` before the first `reset`, `MapError` and `OSError`.
        """
        self._started().pipeline.save_map(path)

    def view(self) -> SceneView:
        """The current state as plain data for rendering: ground truth and estimate."""
        episode = self._started()
        return SceneView(
            segments=self._true_world.outline.segments,
            T_world_robot=self._true_world.T_world_robot,
            moving=self._true_world.movers.faces,
            T_world_map=episode.metrics.T_world_map,
            path_world=episode.path_world.points[: episode.path_world.count].copy(),
            path_map=episode.path_map.points[: episode.path_map.count].copy(),
            slam_output=episode.slam_output,
            robot_radius_m=self.config.robot.radius_m,
            p_goals=episode.rows.p_map,
            goal_kinds=np.asarray(episode.rows.kind, np.int64),
            goal_figures={name: getattr(episode.rows, name) for name in LENGTHS},
            target=nearest_goal(episode.rows, episode.target),
            title=f"{self._true_world.outline.name}, {self.config.estimator}, step {episode.metrics.steps}",
            metrics=figures(episode.metrics, self._true_world.truth, episode.slam_output),
        )

    @property
    def slam_output(self) -> SlamOutput:
        """The SLAM output of the last step."""
        return self._started().slam_output

    @property
    def goals(self) -> Goals:
        """The current goals, as in the observation: those of the exploration, then known ground and waiting."""
        return self._started().rows

    @property
    def goal_actions(self) -> Ints:
        """(g,) the goal action of each of the `goals`, which is the row that describes it."""
        return self.goals.actions(GOALS, self._apart)

    def goal_at(self, action: int) -> int | None:
        """Where in `goals` that of a goal action is; None where it has none."""
        return self.goals.at(action, GOALS, self._apart)

    @property
    def goals_left(self) -> int:
        """How many goals of the exploration are left; without one the episode ends."""
        return len(self._started().goals)

    def aim_at(self, p_map: Array) -> None:
        """Set the target of a goal action, for rendering."""
        self._started().target = p_map.copy()

    def record_drive(self, goals: Goals, row: int, ended: Outcome) -> None:
        """Record how a drive to a goal ended, and search for goals again."""
        episode = self._started()
        episode.target = None
        episode.goal_history.record(goals, row, ended, self._planning.goals)
        self.refresh_goals()

    def observation(self) -> Observation:
        """The current observation, in fresh arrays."""
        episode = self._started()
        observation, episode.saturated = self._seen_by(self._observer, episode)
        return observation

    def info(self) -> dict[str, Any]:
        """Ground truth, metrics and reward terms of the last step: fixed keys, all finite, no wall clock.

        `saturated` is that of the last observation; after `set_state` the reward terms are 0 until the next step.
        """
        episode, terms = self._started(), self._terms
        return {
            "period": episode.metrics.steps,
            **({"event": ""} if self.config.info_texts else {}),
            "building": self._true_world.building,
            "truth_pose": episode.metrics.T_map_robot.copy(),
            "truth_room": self._true_world.truth.room_at(self._true_world.T_world_robot[:2]),
            "goals": len(episode.goals),
            "contact": episode.contact,
            "diverged": episode.slam_output.diverged,
            "lost": episode.metrics.lost.is_lost(episode.slam_output.diverged),
            "confidence": episode.slam_output.confidence,  # of the estimator: position error below 0.5 m
            "localised": episode.slam_output.localised,
            "saturated": episode.saturated,
            "landmarks_dropped": episode.pipeline.filter.dropped,  # that did not fit into a full filter
            **figures(episode.metrics, self._true_world.truth, episode.slam_output),
            **dict(zip(self._reward_keys, terms.values(), strict=True)),
        }

    def observer_of(self, seen: ObservationConfig, actions: str) -> Observer | Flat | Image:
        """What computes observations with those fields, for a policy with those actions (see `observed_by`)."""
        laser = self.config.laser
        if seen.format == "flat":
            return Flat(actions, seen.uncertainty, RowTimes.of(self._planning))
        if seen.format == "image":
            return Image()
        beams = laser.beams * self._slam.clustering.united(laser.sweeps)
        return Observer(seen.map, beams if seen.scan else 0, laser.max_range_m, seen.uncertainty)

    def observed_by(self, observer: Observer | Flat | Image) -> Observation:
        """The current observation as another observer computes it, in fresh arrays."""
        return self._seen_by(observer, self._started())[0]

    def summary(self) -> dict[str, float]:
        """The metrics of the episode until now, from ground truth (`EpisodeMetrics.summary`, `TrueWorld.counts`)."""
        episode = self._started()
        return episode.metrics.summary(self._true_world.truth, episode.slam_output) | self._true_world.counts()

    @property
    def spec(self) -> EnvSpec | None:
        """The specification from `gymnasium.make`; its keywords are plain data.

        `max_episode_steps` is `config.max_steps`, in control steps, unless `gymnasium.make` was given another one, with
        which Gymnasium's `TimeLimit` cuts after so many calls of `step`.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = copy.copy(spec)
        if self._spec is not None:
            self._spec.kwargs = plain_value(self._spec.kwargs)
            self._spec.max_episode_steps = self._spec.max_episode_steps or self.config.max_steps

    def __getstate__(self) -> dict[str, Any]:
        """For pickle and deepcopy: the constructor arguments and the state of the running episode."""
        spaces = {"action_space": self.action_space, "observation_space": self.observation_space}
        made_from = {"config": self.config.to_dict(), "render_mode": self.render_mode, "spec": self._spec}
        random = {"_np_random": self._np_random, "_np_random_seed": self._np_random_seed}
        return made_from | {"attributes": spaces | random, "state": self.get_state() if self._episode else None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        MecpEnv.__init__(self, state["config"], state["render_mode"])
        self.spec = state["spec"]
        self.__dict__.update(state["attributes"])
        if state["state"] is not None:
            self.set_state(state["state"])

    def _running(self) -> EpisodeState:
        episode = self._started()
        if episode.over:
            raise ResetNeeded("step() after the end of the episode; call reset()")
        return episode

    def _started(self) -> EpisodeState:
        if self._episode is None:
            raise ResetNeeded("call reset() first")
        return self._episode

    def _new_observer(self) -> Observer | Flat | Image:
        return self.observer_of(self.config.observation, self.config.actions)

    def _begin(self) -> EpisodeState:
        """A new episode at the simulation's pose, with its scans at rest."""
        pose = self._true_world.T_world_robot
        pipeline = self._oracle.make_pipeline(self._slam)
        world = self._true_world
        metrics = EpisodeMetrics.begin(world.truth, pose, world.obstacles(), self.config.max_steps)
        for _ in range(SCANS_AT_REST):
            self._oracle.inform(pipeline, self._true_world, metrics)
            output = pipeline.start(self._look(pose))
            metrics.look(self._true_world.truth, pose, output, self._true_world.obstacles())
        metrics.compare_map(self._true_world.truth, output, due=True)
        self._episode = episode = EpisodeState(pipeline, output, metrics)
        self._follow(episode, pose)
        self.refresh_goals()
        episode.memory = new_memory(self._reward_inputs(episode), self.config.reward)
        return episode

    def _estimate(self, episode: EpisodeState, motion: Motion, T_world_robot: Array) -> SlamOutput:
        """The SLAM output of this step; only "known" and "truth" use ground truth."""
        odometry, scan = self._sense(motion, T_world_robot)
        self._oracle.inform(episode.pipeline, self._true_world, episode.metrics)
        output = episode.pipeline.step(odometry, scan)
        episode.note_recognised(output.match)
        return output

    def _look(self, T_world_robot: Array) -> Scan:
        """A scan from where the robot is."""
        return self._true_world.look(T_world_robot, self.np_random)

    def _sense(self, motion: Motion, T_world_robot: Array) -> tuple[Odometry, Scan]:
        """The measurements of odometry and laser for a step."""
        odometry = measure(motion, self.config.odometry, self.np_random)
        return odometry, self._look(T_world_robot)

    def _find_goals(self, episode: EpisodeState) -> None:
        """Search for goals when the map changed, at most every few steps, and at once when none is left."""
        episode.goal_history.notice(episode.slam_output)
        due = episode.slam_output.step - episode.goals_step >= self.config.goal_steps
        if (due and episode.goals_key != goals_key(episode.slam_output)) or not len(episode.goals):
            self.refresh_goals()

    def refresh_goals(self) -> None:
        """Search for goals now; rooms without goals become complete in the grid."""
        episode = self._started()
        episode.goals = find_goals(episode.slam_output, episode.goal_history, self._planning)
        if self._apart:
            episode.goals = most_floor_first(episode.goals, episode.slam_output.grid)
        painter, graph = episode.pipeline.grid, episode.slam_output.graph
        painter.complete(complete_rooms(episode.goals, episode.goal_history, graph))
        if not len(episode.goals):
            episode.slam_output = replace(episode.slam_output, grid=painter.finish(graph))
        travelled = episode.path_map.points[: episode.path_map.count]
        around = Surroundings(episode.slam_output, episode.goal_history, travelled)
        episode.offered = offered_goals(episode.goals, around, self._planning, GOALS)
        if self._apart and episode.offered is not None:
            episode.offered = best_place_last(episode.offered, episode.slam_output.belief.pose_cov)
        episode.goals_step, episode.goals_key = episode.slam_output.step, goals_key(episode.slam_output)

    def _compare(self, episode: EpisodeState, motion: Motion, T_world_robot: Array) -> None:
        """Compare the estimate with ground truth."""
        episode.contact = motion.contact
        episode.metrics.move(self._true_world.truth, motion.increments, motion.contact)
        episode.metrics.look(self._true_world.truth, T_world_robot, episode.slam_output, self._true_world.obstacles())
        self._follow(episode, T_world_robot)

    def _follow(self, episode: EpisodeState, T_world_robot: Array) -> None:
        episode.path_map.add(episode.slam_output.belief.T_map_robot)
        episode.path_world.add(T_world_robot)

    def _ends(self, episode: EpisodeState) -> tuple[bool, bool]:
        """Whether the task is done, and whether the episode is cut short."""
        enough = self.config.end.coverage
        seen = enough is not None and episode.metrics.coverage(self._true_world.truth) >= enough
        lost = episode.slam_output.diverged  # the map is then ignored
        done = (self._nothing_left(episode) or seen) and not lost
        cut = not done and (episode.metrics.steps >= self.config.max_steps or lost)
        episode.over = done or cut
        if episode.over:
            episode.metrics.compare_map(self._true_world.truth, episode.slam_output, due=True)
        return done, cut

    def _nothing_left(self, episode: EpisodeState) -> bool:
        """True when no goal is left in what is mapped: at once, or for several steps with pedestrians, who may hide a
        door or block a path, or a blind side, where a path may be. No polygon surrounds a laser that has one. Nobody
        knows what is left while the pose is searched for.
        """
        output = episode.slam_output
        mapped = len(output.map_polygons) > 0 or (output.beams.blind and len(output.belief.ids) > 0)
        empty = not len(episode.goals) and mapped and output.localised
        episode.quiet = episode.quiet + 1 if empty else 0
        if not (empty and (self.config.crowd.people or output.beams.blind)):
            return empty
        episode.pipeline.grid.look_again()
        episode.goal_history.retry_refused(self._planning.goals)
        return episode.quiet >= self.config.end.quiet_steps

    def _rewards(self, episode: EpisodeState, terminated: bool) -> dict[str, float]:
        """The terms of this step's reward, weighted."""
        measured = measured_terms(episode.memory, self._reward_inputs(episode), self.config.reward)
        output = episode.slam_output
        metrics, truth = episode.metrics, self._true_world.truth
        lost = episode.over and metrics.lost.is_lost(output.diverged)
        lost_m2 = metrics.misplaced_m2(truth) if lost else None
        off = metrics.lost.off_steps > 0
        happened = Happened(episode.contact, off, terminated, output.diverged, lost_m2, self.config.max_steps)
        return apply_weights(self._weights, measured | events(episode.memory, happened))

    def _reward_inputs(self, episode: EpisodeState) -> RewardInputs:
        """The inputs of the measured reward terms."""
        output, metrics, truth = episode.slam_output, episode.metrics, self._true_world.truth
        by_truth = self.config.reward.source == "truth"
        return RewardInputs(
            output.belief,
            output.grid,
            output.diverged,
            true_area_m2=metrics.seen_cells * CELL_M**2 if by_truth else None,
            true_shares=(metrics.coverage(truth), metrics.quality.correct_coverage) if by_truth else None,
            free_area_m2=truth.free_cells * CELL_M**2,
            budget=1.0 - metrics.steps / self.config.max_steps,
            p_goals=NO_GOALS if episode.over else episode.goals.p_map,
            over=episode.over,
        )

    def _seen_by(self, observer: Observer | Flat | Image, episode: EpisodeState) -> tuple[Observation, int]:
        budget = 1.0 - episode.metrics.steps / self.config.max_steps
        features, rows, path = episode.pipeline.map.features, episode.rows, episode.path_map
        return observer.observe(Seen(episode.slam_output, features, rows, path, episode.recognised, budget))

    def _paint(self) -> Bytes:
        from mecp_env.render.screen import Screen  # pygame is loaded only for rendering

        self._screen = self._screen or Screen()
        frame: Bytes = self._screen.frame(self.view())
        return frame

    def _show(self) -> None:
        """Draw the window of the "human" mode."""
        if self.render_mode == "human":
            from mecp_env.render.window import Window

            self._window = self._window or Window(str(self._true_world.outline.name))
            self._window.show(self._paint())
