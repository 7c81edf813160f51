"""The true world of an episode: building, doors and walls, dynamic obstacles, the robot's body."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import numpy as np

from mecp_env.config import EnvConfig
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.sensors import Scan
from mecp_env.core.snapshot import StateError, damage_refused
from mecp_env.episode.buildings import check_number, choose_buildings, draw_building, make_source
from mecp_env.episode.episode import EpisodeState, check_arrays, check_truth
from mecp_env.episode.start import Start, check_start, start_pose
from mecp_env.evaluation.ground_truth import CELL_M, NO_OBSTACLES, DynamicObstacles, GroundTruth
from mecp_env.world.config import LaserConfig
from mecp_env.world.doors import close_doors, draw_closed
from mecp_env.world.laser import Laser
from mecp_env.world.moving_obstacles import Movers, Moving, no_movers, wants_movers
from mecp_env.world.outline import Outline, build_outline
from mecp_env.world.pedestrians import WalkwayPlanner
from mecp_env.world.schema import Layout
from mecp_env.world.simulation import Motion, Simulation

KEPT_BUILDINGS = 4  # that the environments of a process share and do not compute again
DARK_SEEDS = 1_000_000  # as many different choices of dark walls


def truth_of(layout: Layout, laser: LaserConfig) -> GroundTruth:
    """The ground truth of the building of `layout`, for a robot with this laser."""
    return GroundTruth(build_outline(layout), laser.max_range_m, laser)


shared_truth = lru_cache(maxsize=KEPT_BUILDINGS)(truth_of)  # of buildings with all doors open: constant


class TrueWorld:
    """The world of an environment, one building after the other, and the robot in it.

    `building` is the index of the building in its source, `outline` its walls in this episode, `truth` the ground truth
    derived from them, `laser` and `simulation` belong to them, `movers` are the pedestrians and boxes.
    """

    building: int
    outline: Outline
    truth: GroundTruth
    laser: Laser
    simulation: Simulation
    movers: Movers
    _obstacles: DynamicObstacles | None  # None: not computed yet

    def __init__(self, config: EnvConfig) -> None:
        """The first building of `config` without obstacles. Raises `ConfigError` or `LayoutError`."""
        self._config = config
        self._source = make_source(config.layout)
        self.building = 0
        self._open_building(0)

    @property
    def T_world_robot(self) -> Array:
        """(3,) m and rad: where the robot is."""
        return self.simulation.T_world_robot

    def begin(self, buildings: range, start: Start, rng: np.random.Generator) -> None:
        """An episode's building, one of those numbers, doors, pedestrians and boxes, with the robot at rest."""
        self._move_to(draw_building(buildings, rng))
        pose = start_pose(start, self.outline, self._config.robot, rng)
        self._populate(pose, rng)
        self.simulation.reset(pose)

    def restore(self, building: int, moving: Moving, body: dict[str, Array], episode: EpisodeState) -> None:
        """Continue in that building with the given dynamic obstacles and body.

        Raises `StateError` where they, or the episode's arrays, do not fit; then this world is as before.
        """
        before = self.building, self.movers.state, self.simulation.get_state()
        try:
            with damage_refused():
                check_arrays(body, episode, moving)
                self._continue(building, moving, body)
                check_truth(episode, self.truth.free.shape)
        except MecpError:
            self._continue(*before)
            raise

    @contextmanager
    def undone_on_error(self, rng: np.random.Generator) -> Iterator[None]:
        """Within it a step is made; where an error ends it, this world and its random numbers are as before."""
        before, body, bits = copy.deepcopy(self.movers.state), self.simulation.get_state(), rng.bit_generator.state
        try:
            yield
        except BaseException:
            self._continue(self.building, before, body)
            rng.bit_generator.state = bits
            raise

    def _continue(self, building: int, moving: Moving, body: dict[str, Array]) -> None:
        self._move_to(building)
        self._admit(moving)
        self.simulation.set_state(body)

    def drive(self, command: tuple[float, float]) -> Motion:
        """One control step at a normalised command: fractions of the robot's largest speed and turn rate."""
        robot, self._obstacles = self._config.robot, None
        return self.simulation.step(command[0] * robot.max_speed_m_s, command[1] * robot.max_turn_rad_s)

    def look(self, T_world_robot: Array, rng: np.random.Generator) -> Scan:
        """A scan from the robot's pose."""
        return self.laser.scan(T_world_robot, rng, self.obstacles().faces)

    def obstacles(self) -> DynamicObstacles:
        """The dynamic obstacles for laser and metrics, computed once per step."""
        if self._obstacles is None:
            movers = self.movers
            self._obstacles = (
                DynamicObstacles(movers.faces, movers.box_corners, movers.walking) if len(movers) else NO_OBSTACLES
            )
        return self._obstacles

    def counts(self) -> dict[str, float]:
        """The numbers of pedestrians, boxes and closed doors, and of the rooms that those cut off.

        They are fewer than configured where no more fit, and where too few rooms would be left.
        """
        moving = self.movers.state
        return {
            "people": len(moving.pedestrians),
            "boxes": len(moving.boxes),
            "closed_doors": len(moving.closed),
            "rooms_cut_off": len(self._open.outline.rooms) - len(self.outline.rooms),
        }

    def choose_buildings(self, number: Any, difficulty: Any) -> range:
        """The numbers of the buildings that the options of a reset allow. Raises `ConfigError`."""
        return choose_buildings(number, difficulty, self._source)

    def building_of(self, state: dict[str, Any]) -> int:
        """The building of a state. Raises `StateError`."""
        try:
            return check_number(state["building"], self._source.all)
        except ConfigError as error:
            raise StateError(f"state.{error}") from None

    def check_start(self, start: Any) -> Start:
        """`start` if an episode may start so. Raises `ConfigError`; a pose belongs to one building."""
        if self._source.count > 1 and not isinstance(start, str):
            raise ConfigError(f'start: {start!r:.80}, in buildings that change only "layout" or "random"')
        return check_start(start, self._open.outline, self._config.robot)

    def _move_to(self, building: int) -> None:
        """Be in the building of that number, all doors open."""
        if building != self.building:
            self._open_building(building)
        elif self.truth is not self._open:
            self._enter(self._open)

    def _open_building(self, building: int) -> None:
        self._open: GroundTruth = shared_truth(self._source.layout(building), self._config.laser)
        self.building = building
        self._enter(self._open)

    def _enter(self, truth: GroundTruth) -> None:
        """Be among its walls."""
        self.truth, self.outline = truth, truth.outline
        self.laser = Laser(self.outline, self._config.laser)
        self.simulation = Simulation(self.outline, self._config.robot)
        self.movers, self._obstacles = no_movers(self._config.robot), NO_OBSTACLES
        self._walkways: WalkwayPlanner | None = None  # None without pedestrians and boxes

    def _populate(self, start: Array, rng: np.random.Generator) -> None:
        """Close doors, choose dark walls, let pedestrians and boxes in: an episode that starts at a pose (3,)."""
        clutter = self._config.clutter
        closed = draw_closed(self.outline, start, clutter, rng)
        dark_seed = int(rng.integers(DARK_SEEDS)) if self._config.laser.has_dark_walls else 0
        self._admit(Moving(closed=closed, start=start[:2].copy(), dark_seed=dark_seed))
        if wants_movers(self._config.crowd, clutter):
            self.movers.populate(self.outline, clutter, rng)
            self.simulation.admit(self.movers)
            self._obstacles = None

    def _admit(self, moving: Moving) -> None:
        """Be in the building with these doors closed and walls dark, among these pedestrians and boxes."""
        if len(moving.closed):
            layout = close_doors(self._source.layout(self.building), moving.closed, moving.start)
            self._enter(truth_of(layout, self._config.laser))
        if self._config.laser.has_dark_walls:
            self.laser = Laser(self.outline, self._config.laser, moving.dark_seed)
        crowd = self._config.crowd
        if self._walkways is None and wants_movers(crowd, self._config.clutter):
            self._walkways = WalkwayPlanner(self.truth.free, self.truth.corner, CELL_M, crowd.radius_m[1])
        self.movers, self._obstacles = Movers(self._walkways, crowd, self._config.robot, moving), None
        self.simulation.admit(self.movers)
