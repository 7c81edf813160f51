"""Dynamic obstacles: pedestrians avoid walls, each other and (if polite) the robot; boxes slide; doors close."""

import copy
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from mecp_env.evaluation.ground_truth import CELL_M, GroundTruth
from mecp_env.world import pedestrians as crowd
from mecp_env.world.config import ClutterConfig, CrowdConfig, LaserConfig, RobotConfig
from mecp_env.world.doors import draw_closed
from mecp_env.world.drive import wall_distance
from mecp_env.world.laser import Laser
from mecp_env.world.moving_obstacles import Movers, Moving, moving_faces
from mecp_env.world.pedestrians import WalkwayPlanner, clear_leg
from mecp_env.world.simulation import Simulation
from tests.world.conftest import OUTLINES
from tests.world.rays import cast_rays

Array = NDArray[np.float64]
ROBOT = RobotConfig()


def world(name: str, seed: int = 0, **fields: Any) -> tuple[Simulation, Movers]:
    """A simulation with pedestrians and boxes in a shipped layout, the robot at its first start."""
    outline = OUTLINES[name]
    config = CrowdConfig(**{"people": 6} | {k: v for k, v in fields.items() if k in CrowdConfig.model_fields})
    clutter = ClutterConfig(**{k: v for k, v in fields.items() if k in ClutterConfig.model_fields})
    truth = GroundTruth(outline, 30.0)
    ways = WalkwayPlanner(truth.free, truth.corner, CELL_M, config.radius_m[1])
    movers = Movers(ways, config, ROBOT, Moving(start=outline.starts[0, :2].copy()))
    movers.populate(outline, clutter, np.random.default_rng(seed))
    simulation = Simulation(outline, ROBOT, movers)
    return simulation, movers


def in_a_door(seed: int, **fields: Any) -> tuple[Simulation, Movers]:
    """The robot in a door, where pedestrians who are not polite, and boxes, push it."""
    simulation, movers = world("two_rooms", seed, polite=False, speed_m_s=(0.8, 1.2), **fields)
    simulation.reset(np.array([*OUTLINES["two_rooms"].doors.centre[0], 0.0]))
    return simulation, movers


def gaps(movers: Movers, p_robot: Array) -> tuple[Array, Array]:
    """(n,) m from the outline of each pedestrian to that of the robot, and to the nearest other pedestrian."""
    pedestrians = movers.state.pedestrians
    p, radius = pedestrians[:, :2], pedestrians[:, crowd.RADIUS]
    apart = np.hypot(*(p[:, None] - p[None]).T) - radius[:, None] - radius[None]
    np.fill_diagonal(apart, np.inf)
    return np.hypot(*(p - p_robot).T) - radius - ROBOT.radius_m, apart.min(axis=0)


def random_drive(simulation: Simulation, steps: int, seed: int = 0) -> Any:
    """Commands without perception; yields after each step whether the robot touched something."""
    rng = np.random.default_rng(seed)
    v = w = 0.0
    for step in range(steps):
        if step % 8 == 0:
            v, w = rng.uniform(-0.2, 0.75), rng.uniform(-1.0, 1.0)
        yield simulation.step(v, w).contact


@pytest.mark.parametrize(("name", "polite"), [("paper", True), ("furnished", False)])
def test_no_pedestrian_walks_through_walls_or_others_nor_if_polite_up_to_a_robot_that_drives(
    name: str, polite: bool
) -> None:
    simulation, movers = world(name, people=10, polite=polite)
    walked, rooms = np.zeros(len(movers.state.pedestrians)), [set[int]() for _ in movers.state.pedestrians]
    for _ in random_drive(simulation, 500 if name == "paper" else 250):
        pedestrians = movers.state.pedestrians
        for walker in pedestrians:
            assert wall_distance(OUTLINES[name].segments, walker[0], walker[1]) > walker[crowd.RADIUS] - 1e-6
        assert shapely.contains_xy(OUTLINES[name].free_area, *pedestrians[:, :2].T).all()
        to_robot, to_others = gaps(movers, simulation.T_world_robot[:2])
        assert to_others.min() > -1e-9
        towards = simulation.T_world_robot[:2] - pedestrians[:, :2]
        closing = (towards * pedestrians[:, [crowd.VX, crowd.VY]]).sum(axis=1) > 1e-6
        near = closing & (pedestrians[:, crowd.MOVES] > 0.0) & (to_robot < crowd.POLITE_M - 0.03)
        assert not (polite and near.any())
        walked += np.hypot(*(pedestrians[:, :2] - pedestrians[:, [crowd.FROM_X, crowd.FROM_Y]]).T)
        for seen, room in zip(rooms, OUTLINES[name].room_at(pedestrians[:, :2]).tolist(), strict=True):
            seen.add(room)
    assert walked.mean() > 12.0  # m in 100 s: they do walk
    assert name != "paper" or min(len(seen - {-1}) for seen in rooms) >= 2


def test_pedestrians_who_are_not_polite_bump_into_the_robot_but_not_through_it() -> None:
    simulation, movers = in_a_door(1)
    touched, deepest = 0, np.inf
    for _ in range(400):
        touched += simulation.step(0.0, 0.0).contact
        deepest = min(deepest, gaps(movers, simulation.T_world_robot[:2])[0].min())
        x, y, _ = simulation.T_world_robot
        assert wall_distance(OUTLINES["two_rooms"].segments, x, y) > ROBOT.radius_m - 0.01
    assert touched > 0
    assert deepest > -0.12


def test_a_pushed_box_moves_and_stops_and_stays_out_of_walls() -> None:
    outline = OUTLINES["two_rooms"]
    state = Moving(boxes=np.array([[2.5, 3.5, 0.3, 0.0, 0.0, 0.0]]), sizes=np.array([[0.4, 0.5]]))
    movers = Movers(None, CrowdConfig(), ROBOT, state)
    simulation, floor = Simulation(outline, ROBOT, movers), outline.free_area.buffer(0.03)
    simulation.reset(np.array([1.0, 3.5, 0.0]))
    for step in range(45):
        simulation.step(0.75, 0.0)
        assert shapely.contains_xy(floor, *movers.box_corners.T).all(), step
    assert movers.state.boxes[0, 0] > 3.5
    for _ in range(10):
        simulation.step(-0.2, 0.0)
    assert not movers.state.boxes[0, 3:].any()


def test_the_laser_sees_pedestrians_and_boxes() -> None:
    outline, pose = OUTLINES["paper"], np.array([2.0, 2.0, 0.0])
    faces = moving_faces(np.array([[3.0, 2.0, 0.25]]), np.array([[2.0, 3.0, 0.0]]), np.array([[0.4, 0.2]]))
    laser = Laser(outline, LaserConfig(preset="ideal", sweeps=1))
    scan = laser.scan(pose, np.random.default_rng(0), faces)
    seen = np.interp([0.0, np.pi / 2.0], scan.bearings[0], scan.ranges[0])  # ahead and on the left
    assert seen == pytest.approx([0.75, 0.9], abs=0.01)
    exact = cast_rays(np.concatenate([outline.segments, faces]), pose)
    assert scan.ranges[0] == pytest.approx(np.minimum(exact, 30.0))


def test_doors_are_drawn_by_their_probability_and_not_beside_the_start() -> None:
    outline, rng, start = OUTLINES["paper"], np.random.default_rng(0), np.array([1.0, 1.0, 0.0])
    half, every = (ClutterConfig(closed_doors=share, reachable_share=0.0) for share in (0.5, 1.0))
    state = rng.bit_generator.state
    assert not len(draw_closed(outline, start, ClutterConfig(), rng))
    assert rng.bit_generator.state == state
    counts = [len(draw_closed(outline, start, half, rng)) for _ in range(200)]
    assert np.mean(counts) == pytest.approx(0.5 * len(outline.doors), rel=0.15)
    assert 2 not in draw_closed(outline, np.array([*outline.doors.centre[2], 0.0]), every, rng)


def test_a_leg_is_clear_when_no_face_comes_near() -> None:
    outline, rng = OUTLINES["furnished"], np.random.default_rng(1)
    walls = shapely.MultiLineString(outline.segments.tolist())
    x0, y0, x1, y1 = outline.bounds
    for _ in range(300):
        a = rng.uniform((x0, y0), (x1, y1))
        b = a + rng.uniform(-1.5, 1.5, 2)
        far = shapely.distance(walls, shapely.LineString([a, b]))
        if abs(far - 0.25) > 1e-6 and shapely.distance(walls, shapely.Point(a)) > 0.25:
            assert clear_leg(outline.segments, *a, *b, 0.25) == (far > 0.25)


@pytest.mark.parametrize("boxes", [0, 12])
def test_states_in_contact_with_several_bodies_continue_bit_for_bit(boxes: int) -> None:
    """In pymunk the order of contacts depended on the past of the space: each control step has its own space now."""
    rng, touched = np.random.default_rng(0), 0
    simulation, movers = in_a_door(0, people=8, movable_boxes=boxes)
    for _ in range(10):
        touched += sum(simulation.step(*rng.uniform([-0.3, -0.8], [0.75, 0.8])).contact for _ in range(3))
        twin, other = copy.deepcopy((simulation, movers))
        for v, w in rng.uniform([-0.3, -0.8], [0.75, 0.8], (4, 2)):
            assert twin.step(v, w).increments.tobytes() == simulation.step(v, w).increments.tobytes()
            assert twin.get_state()["body"].tobytes() == simulation.get_state()["body"].tobytes()
            assert other.state.boxes.tobytes() == movers.state.boxes.tobytes()
            assert other.state.pedestrians.tobytes() == movers.state.pedestrians.tobytes()
    assert touched > 5
