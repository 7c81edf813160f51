"""The physics: motion as commanded, contacts flagged, no path through walls."""

import math

import numpy as np
import pymunk
import pytest
import shapely
from scipy.optimize import nnls

from mecp_env.core.carriers import Array
from mecp_env.core.se2 import compose
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import TOUCH_M, RobotLimits, leave_walls, slide, wall_distance, wheels
from mecp_env.world.outline import Outline, random_free_pose
from mecp_env.world.simulation import Simulation

ROBOT = RobotConfig()


def at(outline: Outline, x: float, y: float, heading: float = 0.0) -> Simulation:
    simulation = Simulation(outline, ROBOT)
    simulation.reset(np.array([x, y, heading]))
    return simulation


def test_two_seconds_at_half_a_metre_a_second_are_one_metre(paper: Outline) -> None:
    simulation = at(paper, 1.0, 1.0)
    for _ in range(3):
        simulation.step(0.5, 0.0)
    before = simulation.T_world_robot
    path = sum(simulation.step(0.5, 0.0).increments[:, 0].sum() for _ in range(5))
    assert simulation.T_world_robot - before == pytest.approx([1.0, 0.0, 0.0])
    assert path == pytest.approx(1.0)


def test_acceleration_is_limited(paper: Outline) -> None:
    simulation = at(paper, 1.0, 1.0)
    speeds = []
    for _ in range(4):
        simulation.step(10.0, 0.0)
        speeds.append(float(np.hypot(*simulation.get_state()["body"][3:5])))
    assert speeds == pytest.approx([0.4, 0.75, 0.75, 0.75])
    simulation.step(-10.0, 10.0)
    assert simulation.get_state()["body"][5] == pytest.approx(1.75)
    assert float(np.hypot(*simulation.get_state()["body"][3:5])) == pytest.approx(0.35)


def test_increments_add_up_to_the_pose_and_a_turn_in_place_stays_in_place(paper: Outline) -> None:
    rng = np.random.default_rng(3)
    for commands in (rng.uniform((-0.2, -1.5), (0.3, 1.5), (50, 2)), np.tile([0.0, 1.0], (7, 1))):
        simulation = at(paper, 16.0, 11.0)
        for v, w in commands:
            pose = simulation.T_world_robot
            motion = simulation.step(v, w)
            assert not motion.contact
            for distance, turn in motion.increments:
                half = np.array([distance * math.cos(turn / 2.0), distance * math.sin(turn / 2.0), turn])
                pose = compose(pose, half)
            assert pose == pytest.approx(simulation.T_world_robot, abs=4e-4)
    assert simulation.T_world_robot[:2] == pytest.approx([16.0, 11.0], abs=1e-12)


FAST = RobotConfig(max_speed_m_s=0.88, max_acceleration_m_s2=100.0, max_turn_acceleration_rad_s2=1000.0)


@pytest.mark.parametrize("robot", [ROBOT, FAST])
def test_the_robot_never_leaves_the_free_space(outline: Outline, robot: RobotConfig) -> None:
    """With the largest stride that a configuration allows, too, at every angle, the way never crosses a wall."""
    assert FAST.max_speed_m_s * FAST.substep_s == pytest.approx(0.1 * FAST.radius_m)
    simulation, rng = Simulation(outline, robot), np.random.default_rng(0)
    inner = outline.free_area.buffer(-(robot.radius_m - 0.002))
    contacts, last = 0, simulation.T_world_robot[:2]
    for step in range(500):
        if robot is FAST or step % 6 == 0:
            command = rng.choice([-1.0, 1.0, 1.0]), rng.uniform(-1.75, 1.75)
        contacts += simulation.step(*command).contact
        here = simulation.T_world_robot[:2]
        assert shapely.contains_xy(inner, *here)
        assert wall_distance(outline.segments, *here) > robot.radius_m - 0.002
        assert np.hypot(*(here - last)) < robot.max_speed_m_s * robot.substep_s * 16 + 1e-3
        last = here
    assert contacts > 50


class PymunkDrive:
    """The robot among walls as pymunk alone moves it, by control steps from any state.

    Where several walls are touched at once, the ten iterations of pymunk's solver leave an error.
    """

    def __init__(self, segments: Array, config: RobotConfig) -> None:
        self.config, self.segments, self.limits = config, segments, RobotLimits.of(config)
        self.space = pymunk.Space()
        self.space.collision_slop, self.space.collision_bias, self.space.collision_persistence = 0.0, 1.0, 1
        walls = [pymunk.Segment(self.space.static_body, a, b, 0.0) for a, b in segments.tolist()]
        self.body = pymunk.Body(9.0, 9.0 * config.radius_m**2 / 2.0)
        self.space.add(*walls, self.body, pymunk.Circle(self.body, config.radius_m))
        self.most_contacts = 0  # at the same time, in the last step

    def step(self, state: Array, v: float, w: float) -> tuple[Array, bool]:
        """The state (6,) after a control step with a command, and whether a wall was touched."""
        state, touched = state.copy(), False
        self.most_contacts = 0
        for _ in range(self.config.arcs * self.config.substeps):
            aim = np.array(wheels(state, self.limits, v, w))
            velocity = self._substep(state, aim)
            touched |= bool(np.hypot(*(velocity - aim)[:2]) > 1e-6)
            state = np.concatenate([state[:3] + state[3:] * self.limits.dt, velocity])
            leave_walls(self.segments, state, self.config.radius_m - TOUCH_M)
        return state, touched

    def _substep(self, state: Array, aim: Array) -> Array:
        """(3,) the velocity and turn rate that walls leave of those that the wheels aim at."""
        x, y, angle, vx, vy, spin = state.tolist()
        body, dt = self.body, self.limits.dt
        body.position, body.angle, body.velocity, body.angular_velocity = (x, y), angle, (vx, vy), spin
        body.force = tuple(body.mass / dt * (aim[:2] - state[3:5]))
        body.torque = body.moment / dt * (aim[2] - spin)
        self.space.step(dt)
        contacts: list[pymunk.Arbiter] = []
        body.each_arbiter(contacts.append)
        self.most_contacts = max(self.most_contacts, len(contacts))
        return np.array([*body.velocity, body.angular_velocity])


def test_one_wall_at_a_time_is_as_in_pymunk(outline: Outline) -> None:
    """To rounding, and every contact is noted where pymunk notes one."""
    simulation, reference = Simulation(outline, ROBOT), PymunkDrive(outline.segments, ROBOT)
    rng, count = np.random.default_rng(0), 0
    for step in range(900):
        if step % 300 == 0:
            simulation.reset(random_free_pose(outline, rng, ROBOT.radius_m))
        if step % 6 == 0:
            command = rng.uniform(-0.4, 0.75), rng.uniform(-1.75, 1.75) * rng.integers(0, 2)
        expected, touched = reference.step(simulation.get_state()["body"], *command)
        assert simulation.step(*command).contact == touched
        count += touched
        if reference.most_contacts < 2:
            np.testing.assert_allclose(simulation.get_state()["body"], expected, rtol=0.0, atol=1e-12)
    assert count > 70


def test_walls_leave_the_nearest_velocity_that_leads_into_none() -> None:
    """The projection on the cone of the free velocities, by non-negative least squares, for any number of walls."""
    rng, limits, state = np.random.default_rng(8), RobotLimits.of(ROBOT), np.zeros(6)
    for _ in range(300):
        walls = rng.uniform(0.0, 2.0 * math.pi) + rng.uniform(0.0, rng.choice([0.05, 1.0, 3.5]), rng.integers(1, 4))
        into, wanted = np.column_stack([np.cos(walls), np.sin(walls)]), rng.uniform(-0.7, 0.7, 2)
        along = into @ [[0.0, 1.0], [-1.0, 0.0]]
        middle = (ROBOT.radius_m - 0.5 * TOUCH_M) * into  # the robot at the origin touches them all
        faces = np.stack([middle - along, middle + along], axis=1)
        expected = wanted - into.T @ nnls(into.T, wanted)[0]
        assert slide(faces, state, limits, *wanted) == pytest.approx(expected, abs=1e-9)
        assert slide(rng.permutation(faces), state, limits, *wanted) == pytest.approx(expected, abs=1e-9)


def test_wall_distance_agrees_with_shapely(paper: Outline) -> None:
    rng = np.random.default_rng(6)
    for x, y in rng.uniform((0.0, 0.0), (20.0, 14.0), (200, 2)):
        expected = paper.free_area.boundary.distance(shapely.Point(x, y))
        assert wall_distance(paper.segments, x, y) == pytest.approx(expected, abs=1e-3)
