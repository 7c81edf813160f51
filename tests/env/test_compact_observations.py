"""The formats "flat" and "image" against plain twins from the format "dict" of the same episode."""

from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest

from mecp_env.core.errors import ConfigError, KeywordError
from mecp_env.episode.compact_observations import FLAT_GOALS, flat_columns, goal_cells, squash
from mecp_env.episode.observation_arrays import LAYERS
from mecp_env.wrappers import GoalActions
from tests.env.helpers import IDS, NEEDED, drive, make, same

FORMATS = {"flat": (104,), "image": (3, 64, 64)}
STEPS = 25
OWN: dict[str, Any] = {  # places and waiting are goals, too; no beam is on the border of two sectors
    "planning": {"known_ground": {"places": 8}},
    "laser": {"sweeps": 1, "beams": 710},
}


def rollout(steps: int = STEPS, **keywords: Any) -> tuple[gymnasium.Env, list[Any]]:
    env = make(start="random", **keywords)
    first = env.reset(seed=4)[0]
    return env, [first, *(row[0] for row in drive(env, steps))]


def halved(value: float, half: float) -> float:
    return value / (abs(value) + half)


@pytest.mark.parametrize("observation", [{"format": "flat"}, {"format": "flat", "uncertainty": True}], ids=str)
@pytest.mark.parametrize("actions", ["velocity", "goal"])
def test_flat_columns_against_a_plain_twin(observation: dict[str, Any], actions: str) -> None:
    parts = {"uncertainty": True, "scan": True}
    flat_env, dict_env = (make(observation=seen, actions=actions, **OWN) for seen in (observation, parts))
    flat, tables = flat_env.reset(seed=4)[0], dict_env.reset(seed=4)[0]
    bare = [env.env if isinstance(env, GoalActions) else env.unwrapped for env in (flat_env, dict_env)]
    uncertainty, by_row = "uncertainty" in observation, actions == "goal"
    for _ in range(STEPS):
        expected = twin(tables, dict_env.unwrapped, uncertainty, by_row)
        assert tuple(expected) == flat_columns(uncertainty)
        pairs = zip(expected.items(), flat.tolist(), strict=True)
        assert {name: (value, seen) for (name, value), seen in pairs if abs(value - seen) > 1e-5} == {}
        command = np.float32([0.7, 0.3])
        flat, tables = (env.unwrapped.step(command)[0] if by_row else env.step(command)[0] for env in bare)


def twin(seen: dict[str, np.ndarray], env: Any, uncertainty: bool, by_row: bool) -> dict[str, float]:
    """The flat columns from a dict observation, one by one as docs/observations.md says."""
    x, y, cos, sin = seen["pose"].tolist()
    xx, xy, xt, yy, yt, tt = seen["pose_cov"].tolist()
    sx, sy, st = math.sqrt(xx), math.sqrt(yy), math.sqrt(tt)
    named = {"x": halved(x, 10), "y": halved(y, 10), "cos_heading": cos, "sin_heading": sin}
    named |= {"sigma_x": halved(sx, 0.1), "sigma_y": halved(sy, 0.1), "sigma_heading": halved(st, 0.05)}
    pairs = {"x_y": (xy, sx * sy), "x_heading": (xt, sx * st), "y_heading": (yt, sy * st)}
    named |= {f"corr_{name}": cov / product if product else 0.0 for name, (cov, product) in pairs.items()}
    named |= dict(zip(("confidence", "localised", "recognised"), seen["localisation"].tolist(), strict=True))
    grid = env.slam_output.grid
    floor_m2 = float((grid.label != 0).sum()) * grid.resolution_m**2
    named |= {"floor": halved(floor_m2, 100), "goals": halved(len(env.goals), 10)}
    named["landmarks"] = halved(len(env.slam_output.belief.ids), 10)
    nearest_15 = 15 * np.rint(np.degrees(env.slam_output.beams.bearings) / 15) % 360
    for sector in range(0, 360, 15):
        named[f"range_{sector}"] = halved(float(seen["scan"][nearest_15 == sector].min()), 2)
    goals = seen["goals"][seen["goals"][:, 8] == 1.0]
    goals = goals if by_row else goals[np.argsort(goals[:, 2], kind="stable")]
    for k in range(FLAT_GOALS):
        row = goals[k] if k < len(goals) else None
        columns = ("cos", "sin", "distance", "path", "width", "kind") + ("sigma_m", "sigma_rad", "gain") * uncertainty
        values = goal_twin(row)[: len(columns)] if row is not None else [0.0] * len(columns)
        named |= {f"goal_{k}_{name}": value for name, value in zip(columns, values, strict=True)}
    for k, row in enumerate(seen["landmarks"][:4]):
        sigma = halved(math.sqrt(row[2] + row[4]), 0.1)
        values = [*polar_twin(row), sigma] if row[7] else [0.0] * 4
        named |= {
            f"landmark_{k}_{name}": v for name, v in zip(("cos", "sin", "distance", "sigma_m"), values, strict=True)
        }
    return named


def polar_twin(row: np.ndarray) -> list[float]:
    far = math.hypot(row[0], row[1])
    return [row[0] / far if far else 0.0, row[1] / far if far else 0.0, halved(far, 5)]


def goal_twin(row: np.ndarray) -> list[float]:
    predicted = [halved(row[9], 0.1), halved(row[10], 0.05), halved(row[11], 10)]
    return [*polar_twin(row), halved(row[2], 5), halved(row[3], 1), (row[4] + 1) / 7, *predicted]


def test_a_sector_without_beams_is_minus_one() -> None:
    env = make(observation="flat", laser={"preset": "lms200", "sweeps": 1})
    flat = dict(zip(flat_columns(), env.reset(seed=1)[0], strict=True))
    behind = [flat[f"range_{sector}"] for sector in range(105, 270, 15)]
    ahead = [flat[f"range_{sector}"] for sector in (*range(0, 90, 15), *range(285, 360, 15))]
    assert behind == [-1.0] * len(behind)
    assert min(ahead) > 0.0


def test_squashing_keeps_order_and_sign_and_has_no_bound() -> None:
    values = np.array([-1e9, -3.0, 0.0, 0.5, 3.0, 1e9])
    squashed = squash(values, 3.0)
    assert (np.diff(squashed) > 0).all()
    assert np.abs(squashed).max() <= 1.0
    assert (squashed[1], squashed[2], squashed[4]) == (-0.5, 0.0, 0.5)


def test_the_image_shows_the_grid_goals_and_path() -> None:
    _, seen = rollout(observation={"map": True})
    env, images = rollout(observation="image")
    image, coarse = images[-1], dict(zip(LAYERS, seen[-1]["map"], strict=True))
    assert set(np.unique(image[0])) == {0, 170, 255}
    assert set(np.unique(image[1])) <= {0, 85, 170, 255}
    assert set(np.unique(image[2])) <= {0, 85, 170, 255}
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


@pytest.mark.parametrize("observation", FORMATS)
def test_the_episode_is_the_same_in_every_format(observation: str) -> None:
    results = []
    for seen in ("dict", observation):
        env = make(observation=seen, start="random")
        env.reset(seed=2)
        results.append([(row[1:4], row[4] | {"saturated": 0}) for row in drive(env, STEPS)])
    assert same(*results)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("observation", FORMATS)
def test_every_id_takes_every_format_as_word_and_as_setting(name: str, observation: str) -> None:
    short = gymnasium.make(name, observation=observation, **NEEDED.get(name, {}))
    long = gymnasium.make(name, config={"observation": {"format": observation}}, **NEEDED.get(name, {}))
    assert short.unwrapped.config == long.unwrapped.config
    uncertain = short.unwrapped.config.observation.uncertainty  # a word keeps the other settings of a task
    assert uncertain == ("Active" in name)
    assert short.observation_space.shape == ((128,) if uncertain and observation == "flat" else FORMATS[observation])
    assert gymnasium.make(short.spec).observation_space == short.observation_space


@pytest.mark.parametrize("observation", FORMATS)
def test_a_snapshot_continues_with_the_same_observations(observation: str) -> None:
    env = make(observation=observation).unwrapped
    env.reset(seed=3)
    drive(env, 10)
    state, expected = env.get_state(), [row[0] for row in drive(env, 10)]
    env.set_state(state)
    assert same([row[0] for row in drive(env, 10)], expected)


def test_an_unknown_keyword_is_a_type_error_as_python_words_it() -> None:
    for name in IDS:
        with pytest.raises(TypeError, match="got an unexpected keyword argument 'frameskip'") as caught:
            gymnasium.make(name, frameskip=1, **NEEDED.get(name, {}))
        assert isinstance(caught.value, KeywordError)
        assert isinstance(caught.value, ConfigError)
