"""The physics: motion as commanded, contacts flagged, no path through walls, snapshots that continue bit for bit."""

from __future__ import annotations

import copy
import hashlib
import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from mecp_env.core.errors import ActionError, ConfigError, MecpError
from mecp_env.core.se2 import compose
from mecp_env.world.config import RobotConfig
from mecp_env.world.drive import REACH, wall_distance
from mecp_env.world.outline import Outline
from mecp_env.world.simulation import Motion, Simulation
from tests.world.conftest import OUTLINES

Array = NDArray[np.float64]
ROBOT = RobotConfig()


def at(outline: Outline, x: float, y: float, heading: float = 0.0) -> Simulation:
    simulation = Simulation(outline, ROBOT)
    simulation.reset(np.array([x, y, heading]))
    return simulation


def drive(simulation: Simulation, steps: int, seed: int) -> list[Motion]:
    """Random commands, each held for some steps; mostly forward, so that walls are met often."""
    rng = np.random.default_rng(seed)
    motions, v, w = [], 0.0, 0.0
    for step in range(steps):
        if step % 6 == 0:
            v, w = rng.uniform(-0.4, 0.75), rng.uniform(-1.75, 1.75) * rng.integers(0, 2)
        motions.append(simulation.step(v, w))
    return motions


def digest(simulation: Simulation, motions: list[Motion]) -> str:
    parts = [motion.increments.tobytes() + bytes([motion.contact]) for motion in motions]
    return hashlib.sha256(b"".join(parts) + simulation.get_state()["body"].tobytes()).hexdigest()


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
        speeds.append(float(np.hypot(*simulation.velocity[:2])))
    assert speeds == pytest.approx([0.4, 0.75, 0.75, 0.75])
    simulation.step(-10.0, 10.0)
    assert simulation.velocity[2] == pytest.approx(1.75)
    assert float(np.hypot(*simulation.velocity[:2])) == pytest.approx(0.35)


def test_a_turn_in_place_stays_in_place(paper: Outline) -> None:
    simulation = at(paper, 2.0, 2.0)
    motions = [simulation.step(0.0, 1.0) for _ in range(7)]
    assert simulation.T_world_robot[:2] == pytest.approx([2.0, 2.0], abs=1e-12)
    assert sum(motion.increments[:, 1].sum() for motion in motions) == pytest.approx(simulation.T_world_robot[2])
    assert not any(motion.contact for motion in motions)


def test_a_circle_closes(paper: Outline) -> None:
    simulation = at(paper, 16.0, 11.0)
    for _ in range(3):
        simulation.step(0.5, 0.5)
    before = simulation.T_world_robot
    steps = 31
    turned = sum(simulation.step(0.5, 0.5).increments[:, 1].sum() for _ in range(steps))
    assert turned == pytest.approx(steps * 0.4 * 0.5)
    chord = 2.0 * 1.0 * abs(math.sin(turned / 2.0))  # radius 0.5 / 0.5
    assert np.linalg.norm(simulation.T_world_robot[:2] - before[:2]) == pytest.approx(chord, abs=1e-4)


def test_increments_add_up_to_the_pose(paper: Outline) -> None:
    simulation = at(paper, 16.0, 11.0)
    rng = np.random.default_rng(3)
    for _ in range(50):
        pose = simulation.T_world_robot
        motion = simulation.step(rng.uniform(-0.2, 0.3), rng.uniform(-1.5, 1.5))
        assert not motion.contact
        for distance, turn in motion.increments:
            half = np.array([distance * math.cos(turn / 2.0), distance * math.sin(turn / 2.0), turn])
            pose = compose(pose, half)
        assert pose == pytest.approx(simulation.T_world_robot, abs=4e-4)


def test_reversing_counts_as_negative_distance(paper: Outline) -> None:
    simulation = at(paper, 3.0, 2.0)
    assert simulation.step(-0.5, 0.0).increments[:, 0].max() < 0.0


def test_a_wall_stops_the_robot_and_is_felt(two_rooms: Outline) -> None:
    simulation = at(two_rooms, 1.0, 3.5)
    felt = [simulation.step(0.75, 0.0).contact for _ in range(30)]
    first = felt.index(True)
    assert all(felt[first:])
    assert simulation.T_world_robot[0] == pytest.approx(4.94 - 0.22, abs=2e-3)
    assert np.hypot(*simulation.velocity[:2]) < 1e-9
    assert simulation.step(0.75, 0.0).increments[:, 0].sum() == pytest.approx(0.0, abs=1e-6)


def test_the_robot_slides_along_a_wall(two_rooms: Outline) -> None:
    simulation = at(two_rooms, 1.0, 4.0, math.radians(30.0))
    for _ in range(8):
        simulation.step(0.5, 0.0)
    before = simulation.T_world_robot
    motion = simulation.step(0.5, 0.0)
    moved = simulation.T_world_robot - before
    assert motion.contact
    assert moved[1] == pytest.approx(0.0, abs=1e-6)
    assert moved[0] > 0.03
    assert moved[2] == pytest.approx(0.0, abs=1e-12)
    assert motion.increments[:, 0].sum() == pytest.approx(moved[0] * math.cos(math.radians(30.0)), abs=1e-6)


def test_the_robot_leaves_a_wall_again(two_rooms: Outline) -> None:
    simulation = at(two_rooms, 4.5, 3.5)
    for _ in range(5):
        simulation.step(0.75, 0.0)
    simulation.step(-0.5, 0.0)
    assert not simulation.step(-0.5, 0.0).contact
    assert simulation.T_world_robot[0] < 4.6


def test_the_robot_passes_a_door(two_rooms: Outline) -> None:
    simulation = at(two_rooms, 4.0, 1.8)
    motions = [simulation.step(0.5, 0.0) for _ in range(10)]
    assert simulation.T_world_robot[0] > 5.5
    assert not any(motion.contact for motion in motions)


def test_the_robot_never_leaves_the_free_space(outline: Outline) -> None:
    simulation = Simulation(outline, ROBOT)
    inner = outline.free_area.buffer(-(ROBOT.radius_m - 0.002))
    poses, contacts = [], 0
    for motion in drive(simulation, 2500, seed=5):
        contacts += motion.contact
        poses.append(simulation.T_world_robot[:2])
    assert contacts > 100
    assert shapely.contains_xy(inner, *np.array(poses).T).all()


def test_pymunk_and_the_kernel_move_alike(paper: Outline) -> None:
    kernel_only, pymunk_only = at(paper, 16.0, 11.0), at(paper, 16.0, 11.0)
    pymunk_only._drive[REACH] = math.inf
    rng = np.random.default_rng(4)
    for _ in range(30):
        v, w = rng.uniform(-0.4, 0.5), rng.uniform(-1.5, 1.5)
        expected = kernel_only.step(v, w)
        found = pymunk_only.step(v, w)
        assert not found.contact
        assert found.increments == pytest.approx(expected.increments, abs=1e-12)
    assert pymunk_only.get_state()["body"] == pytest.approx(kernel_only.get_state()["body"], abs=1e-11)


def test_the_pose_in_pymunk_is_that_of_the_state(two_rooms: Outline) -> None:
    """Of which only the velocities are asked for; against a wall, along it, and where it pushes the robot out."""
    simulation = at(two_rooms, 1.0, 4.0, math.radians(30.0))
    simulation._drive[REACH] = math.inf
    body, contacts = simulation._body, 0
    for motion in drive(simulation, 200, seed=3):
        contacts += motion.contact
        state = simulation.get_state()["body"]
        assert state[2:] == pytest.approx([body.angle, *body.velocity, body.angular_velocity], abs=1e-12)
        assert state[:2] == pytest.approx(body.position, abs=2e-3)  # pymunk receives a push in the next substep
    assert contacts > 20
    for _ in range(20):
        simulation.step(0.5, 0.1)
    assert simulation.get_state()["body"][:2] == pytest.approx(body.position, abs=1e-12)


@pytest.mark.parametrize("command", [(math.nan, 0.0), (0.0, math.inf), (-math.inf, math.nan)])
def test_commands_that_are_not_finite_change_nothing(two_rooms: Outline, command: tuple[float, float]) -> None:
    simulation = at(two_rooms, 2.0, 2.0)
    simulation.step(0.3, 0.3)
    before = simulation.get_state()["body"]
    with pytest.raises(ActionError, match="finite"):
        simulation.step(*command)
    assert np.array_equal(simulation.get_state()["body"], before)


@pytest.mark.parametrize("pose", [(math.nan, 1.0, 0.0), (1.0, 1.0), (5.0, 4.0, 0.0), (0.2, 2.0, 0.0)])
def test_bad_poses_are_refused(two_rooms: Outline, pose: tuple[float, ...]) -> None:
    with pytest.raises(MecpError, match="T_world_robot"):
        Simulation(two_rooms, ROBOT).reset(np.array(pose))


@pytest.mark.parametrize("state", [{}, {"body": np.zeros(5)}, {"body": [math.nan] * 6}])
def test_bad_states_are_refused(two_rooms: Outline, state: dict[str, object]) -> None:
    with pytest.raises(MecpError, match="body"):
        Simulation(two_rooms, ROBOT).set_state(state)


@pytest.mark.parametrize("bad", [{"radius_m": 0.0}, {"arcs": 0}, {"period_s": 3.0}, {"v": 1.0}, {"radius_m": math.nan}])
def test_bad_robots_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="RobotConfig"):
        RobotConfig(**bad)


def test_states_continue_bit_for_bit(outline: Outline) -> None:
    """From 50 points of a drive among walls; by state, pickle and deepcopy; in a world with another past."""
    straight = Simulation(outline, ROBOT)
    other = Simulation(outline, ROBOT)
    contacts = 0
    for point in range(50):
        contacts += sum(motion.contact for motion in drive(straight, 15, seed=point))
        other.set_state(straight.get_state())
        twins = [other, pickle.loads(pickle.dumps(straight)), copy.deepcopy(straight)]
        expected = digest(straight, drive(straight, 10, seed=1000 + point))
        assert [digest(twin, drive(twin, 10, seed=1000 + point)) for twin in twins] == [expected] * 3
    assert contacts > 50


def test_jammed_at_a_corner_a_state_continues_bit_for_bit(paper: Outline) -> None:
    """Two contacts at once, at the convex corner of the bath: their order once hung on where the robot had been."""
    straight, other = at(paper, 4.0, 2.0, math.radians(45.0)), Simulation(paper, ROBOT)
    for _ in range(200):
        other.set_state(straight.get_state())
        turn = 0.1 * math.sin(straight.T_world_robot[0] * 1e6)
        assert np.array_equal(straight.step(0.6, turn).increments, other.step(0.6, turn).increments)
        assert np.array_equal(straight.get_state()["body"], other.get_state()["body"])
        drive(other, 1, seed=7)


def test_get_state_is_a_copy(two_rooms: Outline) -> None:
    simulation = at(two_rooms, 2.0, 2.0)
    state = simulation.get_state()
    simulation.step(0.5, 0.5)
    assert np.array_equal(state["body"], [2.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    simulation.set_state(state)
    simulation.step(0.5, 0.5)
    assert np.array_equal(state["body"], [2.0, 2.0, 0.0, 0.0, 0.0, 0.0])


def test_two_processes_give_the_same_bits() -> None:
    simulation = Simulation(OUTLINES["furnished"], ROBOT)
    here = digest(simulation, drive(simulation, 300, seed=9))
    code = (
        "from tests.world.test_simulation import *\n"
        "s = Simulation(OUTLINES['furnished'], ROBOT)\n"
        "print(digest(s, drive(s, 300, seed=9)))"
    )
    root = Path(__file__).parents[2]
    run = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    assert run.stdout.split()[-1] == here


def test_wall_distance_agrees_with_shapely(paper: Outline) -> None:
    rng = np.random.default_rng(6)
    for x, y in rng.uniform((0.0, 0.0), (20.0, 14.0), (200, 2)):
        expected = paper.free_area.boundary.distance(shapely.Point(x, y))
        assert wall_distance(paper.segments, x, y) == pytest.approx(expected, abs=1e-3)
