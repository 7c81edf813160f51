"""The formats "flat" and "image" against plain twins from the format "dict" of the same episode."""

import itertools
import math
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

import mecp_env
from mecp_env.core.errors import ConfigError
from mecp_env.core.se2 import to_map
from mecp_env.episode.compact_observations import best_place_last, goal_cells, unseen_floor
from mecp_env.episode.observation_arrays import LAYERS
from mecp_env.planning.goal_list import FRONTIER, OPEN, PLACE, WAIT, Goal, Goals
from mecp_env.slam.messages import Cell
from tests.env.helpers import drive, make, until_over

GOAL_NAMES = ("valid", "cos", "sin", "distance", "floor", "near", "width", "visits", "kind")
GOAL_NAMES += ("sigma_m", "sigma_rad", "gain")
STEPS = 25
OWN: dict[str, Any] = {  # places and waiting are goals, too; no beam is on the border of two sectors
    "planning": {"known_ground": {"places": 8, "wait_steps": 5}},
    "laser": {"sweeps": 1, "beams": 710},
}


def halved(value: float, half: float) -> float:
    return value / (abs(value) + half)


@pytest.mark.parametrize("observation", [{"format": "flat"}, {"format": "flat", "uncertainty": True}], ids=str)
@pytest.mark.parametrize("actions", ["velocity", "goal"])
def test_flat_columns_against_a_plain_twin(observation: dict[str, Any], actions: str) -> None:
    parts = {"uncertainty": True, "scan": True}
    flat_env, dict_env = (make(observation=seen, actions=actions, **OWN) for seen in (observation, parts))
    flat, tables = flat_env.reset(seed=4)[0], dict_env.reset(seed=4)[0]
    bare, names = [flat_env.unwrapped, dict_env.unwrapped], mecp_env.flat_names(flat_env)
    for _ in range(STEPS):
        expected = twin(tables, dict_env.unwrapped, len(flat))
        assert expected.keys() == set(names)
        pairs = zip(names, flat.tolist(), strict=True)
        assert {name: (expected[name], seen) for name, seen in pairs if abs(expected[name] - seen) > 2e-5} == {}
        flat, tables = (env.step(np.float32([0.7, 0.3]))[0] for env in bare)


def twin(seen: dict[str, np.ndarray], env: Any, size: int) -> dict[str, float]:
    """The flat columns from a dict observation, one by one as docs/observations.md says."""
    named = head_twin(seen, env)
    nearest_15 = 15 * np.rint(np.degrees(env.slam_output.beams.bearings) / 15) % 360
    for sector in range(0, 360, 15):
        named[f"range_{sector}"] = halved(float(seen["scan"][nearest_15 == sector].min()), 2)
    by_row, predicted = size in (325, 421), size in (229, 421)
    goals = seen["goals"][seen["goals"][:, 8] == 1.0].astype(float)
    config = env.config.planning_config
    seconds = goals[:, 2] / config.control.speed_m_s
    seconds[goals[:, 4] == WAIT] = config.known_ground.wait_steps * 0.4
    order = np.arange(len(goals)) if by_row else np.argsort(seconds, kind="stable")
    most = 32 if by_row else 16
    last = most - len(goals) if by_row else 0  # known ground has the last rows
    rows = [k + (last if goals[i, 4] >= PLACE else 0) for k, i in enumerate(order)]
    described = {row: goal_twin(goals[i], seconds[i], env) for row, i in zip(rows, order, strict=True)}
    for k in range(most):
        values = described.get(k, dict.fromkeys(GOAL_NAMES, 0.0))
        named |= {f"goal_{k}_{name}": values[name] for name in (GOAL_NAMES if predicted else GOAL_NAMES[:9])}
    return named


def head_twin(seen: dict[str, np.ndarray], env: Any) -> dict[str, float]:
    x, y, cos, sin = seen["pose"].tolist()
    xx, xy, _, yy, _, tt = seen["pose_cov"].tolist()
    turn, grid = np.array([[cos, sin], [-sin, cos]]), env.slam_output.grid
    cov = turn @ [[xx, xy], [xy, yy]] @ turn.T
    names = "start_cos", "start_sin", "start_distance", "confidence", "localised", "recognised"
    named = dict(zip(names, [*polar_twin(turn @ [-x, -y], 10), *seen["localisation"].tolist()], strict=True))
    for name, variance, half in (("ahead", cov[0, 0], 0.1), ("left", cov[1, 1], 0.1), ("heading", tt, 0.05)):
        named[f"sigma_{name}"] = halved(math.sqrt(variance), half)
    named |= {"budget": seen["budget"][0], "floor": halved((grid.label != 0).sum() * grid.resolution_m**2, 100)}
    return named | {"goals": halved(len(env.goals), 10), "landmarks": halved(len(env.slam_output.belief.ids), 10)}


def polar_twin(p_robot: np.ndarray, half: float) -> list[float]:
    far = math.hypot(p_robot[0], p_robot[1])
    return [*(p_robot / (far or 1.0)), halved(far, half)]


def goal_twin(row: np.ndarray, seconds: float, env: Any) -> dict[str, float]:
    place = to_map(env.slam_output.belief.T_map_robot, row[None, :2])
    rank = int(np.hypot(*(env.goals.p_map - place).T).argmin())
    floor = halved(plain_unseen(env.goals.p_map[rank], env.slam_output.grid), 5) if row[4] < 4 else 0.0
    values = [1.0, *polar_twin(row[:2], 5), floor, 10 / (10 + seconds), halved(row[3], 1), halved(row[7], 1)]
    values += [(row[4] + 1) / 7, halved(row[9], 0.1), halved(row[10], 0.05), halved(row[11], 10)]
    return dict(zip(GOAL_NAMES, values, strict=True))


def plain_unseen(p_map: np.ndarray, grid: Any) -> float:
    """m^2 of unknown cells that 24 beams of 5 m from a place cross before a wall, at most 2 m of each, in NumPy."""
    bearings, steps = np.arange(24) * (2 * math.pi / 24), np.arange(1, int(5.0 / grid.resolution_m) + 1)
    ways = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)[:, None] * steps[:, None]
    column, row = np.moveaxis(np.floor((p_map - grid.origin) / grid.resolution_m + ways).astype(int), 2, 0)
    rows, columns = grid.label.shape
    inside = (row >= 0) & (column >= 0) & (row < rows) & (column < columns)
    label = np.where(inside, grid.label[row.clip(0, rows - 1), column.clip(0, columns - 1)], Cell.UNKNOWN)
    seen = np.cumsum((label == Cell.OCCUPIED) & (steps * grid.resolution_m > 0.3), axis=1) == 0
    fresh = (label == Cell.UNKNOWN) & seen
    area = (fresh & (np.cumsum(fresh, axis=1) * grid.resolution_m < 2.0 + 1e-9)) * steps
    return float(area.sum()) * grid.resolution_m**2 * 2 * math.pi / 24


@pytest.mark.parametrize("place", [(1.05, 1.05), (-3.0, 0.5), (30.0, 30.0), (2.0, 0.95)])
def test_unseen_floor_against_numpy_also_outside_the_grid(place: tuple[float, float]) -> None:
    label = np.random.default_rng(3).choice([0, 1, 2], (41, 67), p=[0.5, 0.48, 0.02]).astype(np.uint8)
    grid = SimpleNamespace(label=label, origin=np.array([-1.0, -2.0]), resolution_m=0.1)
    expected = plain_unseen(np.array(place), grid)
    assert unseen_floor(*place, (label, grid.origin, grid.resolution_m)) == pytest.approx(expected)


def test_every_offered_row_is_described_with_its_kind() -> None:
    """Over whole episodes: row k of the vector is action k, valid just where the mask is.

    Known ground has the last rows, and the last one waits.
    """
    env = gymnasium.make("mecp_env/ActiveHalls-v0", observation="flat", max_steps=300)
    base, names, rng = env.unwrapped, mecp_env.flat_names(env), np.random.default_rng(0)
    valid, kind = ([names.index(f"goal_{k}_{name}") for k in range(32)] for name in ("valid", "kind"))
    (first, begun), kinds = env.reset(seed=0), set[int]()
    rows = until_over(env, lambda seen: int(rng.choice(np.flatnonzero(seen[valid]))), first)
    for observation, *_, info in itertools.chain([(first, begun)], rows):
        goals, actions, mask = base.goals, base.goal_actions, info["action_mask"]
        assert env.observation_space.contains(observation)
        assert observation[valid].astype(np.int8).tolist() == mask.tolist()
        assert sorted(actions) == np.flatnonzero(mask).tolist()
        assert np.rint(observation[kind] * 7 - 1)[actions].tolist() == goals.kind.tolist()
        assert [base.goal_at(action) for action in actions] == list(range(len(goals)))
        assert goals.kind[actions == 31].tolist() == [WAIT]
        exploring = int((goals.kind < 4).sum())  # they come first, those with most new floor per path before others
        assert actions[:exploring].tolist() == list(range(exploring))
        place = base.slam_output.grid.label, base.slam_output.grid.origin, base.slam_output.grid.resolution_m
        floor = np.array([unseen_floor(x, y, place) for x, y in goals.p_map[:exploring].tolist()])
        value = np.maximum(floor, 0.1) ** 0.7 / (goals.path_m[:exploring] + 2.0)
        assert (np.diff(value) <= 1e-9).all()
        kinds |= set(goals.kind.tolist())
    assert len(kinds) > 2


def test_the_best_place_is_the_last_before_waiting() -> None:
    """Drawn 4 m ahead: sigma on arrival, and 2 % of that of the present pose per metre of the way."""
    here = {"x": 0.0, "y": 0.0, "size_m": 1.0, "room": 0}
    worse, near, far, wait = (
        Goal(PLACE, **here, path_m=1.0, sigma_m=0.3, sigma_rad=0.1),
        Goal(PLACE, **here, path_m=5.0, sigma_m=0.1, sigma_rad=0.02),
        Goal(PLACE, **here, path_m=40.0, sigma_m=0.1, sigma_rad=0.02),
        Goal(WAIT, **here),
    )
    goals = Goals.of([Goal(FRONTIER, **here), Goal(OPEN, **here), far, near, worse, wait])
    sharp, wide = np.diag([0.01, 0.01, 0.0001]), np.diag([0.5, 0.5, 0.04])
    assert best_place_last(goals, sharp).path_m[2:].tolist() == [1.0, 40.0, 5.0, 0.0]
    assert best_place_last(goals, wide).path_m[2:].tolist() == [40.0, 1.0, 5.0, 0.0]
    assert best_place_last(goals, sharp).kind.tolist() == [FRONTIER, OPEN, PLACE, PLACE, PLACE, WAIT]
    assert len(best_place_last(Goals(), wide)) == 0


def test_names_match_the_vector_and_what_is_not_flat_is_refused() -> None:
    for actions, uncertainty in itertools.product(("goal", "velocity", "discrete"), (False, True)):
        env = make(observation={"format": "flat", "uncertainty": uncertainty}, actions=actions)
        names = mecp_env.flat_names(actions=actions, uncertainty=uncertainty)
        assert names == mecp_env.flat_names(env)
        assert len(set(names)) == len(names) == env.observation_space.shape[0]
    with pytest.raises(ConfigError, match="observation='flat', got 'dict'"):
        mecp_env.flat_names(make())
    with pytest.raises(ConfigError, match="expected a mecp_env environment"):
        mecp_env.flat_names(gymnasium.make("CartPole-v1"))
    with pytest.raises(ConfigError, match="did you mean 'goal'"):
        mecp_env.flat_names(actions="goals")


def test_the_image_shows_the_grid_goals_and_path() -> None:
    shows_map, env = (make(start="random", observation=observation) for observation in ({"map": True}, "image"))
    for each in (shows_map, env):
        each.reset(seed=4)
        drive(each, STEPS)
    image, seen = env.unwrapped.observation(), shows_map.unwrapped.observation()
    coarse = dict(zip(LAYERS, seen["map"], strict=True))
    assert set(np.unique(image[0])) == {0, 170, 255}
    assert image[0, 31:33, 31:33].min() == 0  # the robot is on free floor, on its path
    assert image[2, 31:33, 31:33].max() == 255
    shown = image[0].reshape(32, 2, 32, 2).max(axis=(1, 3))  # cells of 0.8 m; the map shows as many around the robot
    middle = slice(16, 48)
    assert np.mean((shown == 255) == (coarse["occupied"][middle, middle] == 255)) > 0.9
    assert len(env.unwrapped.goals) == 0 or (image[1] == 255).any()


def test_goals_are_where_the_image_shows_them() -> None:
    cells = goal_cells(np.array([[4.0, 0.0], [0.0, 4.0], [500.0, 0.0], [-12.75, -12.75]]))
    rows, columns = np.nonzero(cells)
    assert set(zip(rows.tolist(), columns.tolist(), strict=True)) == {
        *((row, column) for row in (21, 22, 23) for column in (31, 32, 33)),  # 4 m ahead
        *((row, column) for row in (31, 32, 33) for column in (21, 22, 23)),  # 4 m to the left
        *((row, column) for row in (62, 63) for column in (62, 63)),  # in the last corner, behind on the right
    }
