"""Mutated snapshots end in `StateError` or in an environment that runs, never in a crash of the process."""

import copy
import json
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from mecp_env.core.snapshot import StateError
from mecp_env.episode.episode import SHAPES
from tests.env.helpers import started
from tests.processes import run_python

PARTS = ("simulation", "moving", "episode")
STEPS = 3  # after each accepted state
NUMBERS = (0, -1, 1, 7, 2**31, -(2**40), 2**62)
FLOATS = (0.0, -1.0, float("nan"), float("inf"), 1e300, 1e5)

CHECKED_BY_HAND = {"SubmapEkf.slot_ids", "SubmapEkf.state", "EpisodeMetrics.visited_by_obstacles"}


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every node of a state."""
    yield path
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list | tuple) else ()
    for key, item in items:
        yield from places(item, (*path, key))


def at(data: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        data = data[key]
    return data


def other_shape(array: np.ndarray[Any, Any], rng: np.random.Generator) -> Any:
    """Cut, repeated, transposed, flat, with another axis, or empty."""
    shapes = [array[None]]
    if array.ndim:
        shapes += [array[:0], array[:-1], array.T, array.ravel(), array[..., :1], np.concatenate([array, array])]
    return shapes[int(rng.integers(len(shapes)))]


def other_values(array: np.ndarray[Any, Any], rng: np.random.Generator) -> Any:
    """One value, or all of them, replaced."""
    if array.dtype.names or not array.size or array.dtype.kind not in "if":
        return array.astype("S3") if array.dtype.kind in "if" else array[::-1]
    changed = array.copy()
    with np.errstate(all="ignore"):
        value = np.array(rng.choice(NUMBERS if array.dtype.kind == "i" else FLOATS)).astype(array.dtype)
    changed[... if rng.random() < 0.3 else tuple(int(rng.integers(n)) for n in array.shape)] = value
    return changed


def other_kind(array: np.ndarray[Any, Any], rng: np.random.Generator) -> Any:
    """Another element type, byte order or layout in memory."""
    kinds = [np.float32, np.int32, np.uint8, np.bool_, np.complex128, ">f8", ">i8"]
    if array.dtype.names:
        return np.zeros(array.shape, [("x", "<i8")])
    with np.errstate(all="ignore"):
        return np.asfortranarray(array) if rng.random() < 0.2 else array.astype(kinds[int(rng.integers(len(kinds)))])


def other_scalar(value: Any, rng: np.random.Generator) -> Any:
    """Another number, of the same kind or of another."""
    if isinstance(value, str):
        return rng.choice(["", "x", "mecp_env.slam.messages:Belief", "os:system", "mecp_env.core.settings:Settings"])
    pool = [*NUMBERS, *FLOATS, None, True, "x"]
    return pool[int(rng.integers(len(pool)))]


def nodes(state: dict[str, Any]) -> dict[str, tuple[list[tuple[Any, ...]], list[tuple[Any, ...]]]]:
    """The paths of all nodes of each part of a state, and of its arrays."""
    paths = {part: [path for path in places(state[part]) if path] for part in PARTS}
    return {
        part: (all_, [p for p in all_ if isinstance(at(state[part], p), np.ndarray)]) for part, all_ in paths.items()
    }


def mutate(state: dict[str, Any], known: dict[str, Any], rng: np.random.Generator) -> str:
    """Change one node of a state whose nodes are known; returns which."""
    part = PARTS[int(rng.choice(3, p=(0.05, 0.1, 0.85)))]
    paths, arrays = known[part]
    path = (arrays if rng.random() < 0.6 and arrays else paths)[int(rng.integers(len(arrays or paths)))]
    parent, key = at(state[part], path[:-1]), path[-1]
    value = parent[key]
    if isinstance(parent, tuple):
        return "nothing"
    if isinstance(value, np.ndarray):
        parent[key] = (other_shape, other_values, other_kind)[int(rng.integers(3))](value, rng)
    elif isinstance(value, dict) and len(value) > 1 and rng.random() < 0.5:
        del value[list(value)[int(rng.integers(len(value)))]]
    elif isinstance(value, dict | list):
        change = [{"@same": int(rng.integers(60))}, {"@list": []}, None, copy.deepcopy(value)][int(rng.integers(4))]
        parent[key] = change
    else:
        parent[key] = other_scalar(value, rng)
    return f"{part}/{'/'.join(map(str, path))}"


def run(first: int, count: int) -> dict[str, int]:
    """Mutate `count` snapshots; the seed of each is written before it is tried, so that a crash is known."""
    env, rng = started(seed=3, crowd={"people": 2}), np.random.default_rng(0)
    for _ in range(25):
        env.step(np.array([0.7, rng.uniform(-0.5, 0.5)], np.float32))
    good, ends = env.get_state(), {"refused": 0, "running": 0}
    known = nodes(good)
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        state = copy.deepcopy(good)
        where = mutate(state, known, rng)
        sys.stderr.write(f"{seed} {where}\n")
        sys.stderr.flush()
        try:
            env.set_state(state)
        except StateError:
            ends["refused"] += 1
            continue
        for _ in range(STEPS):
            env.step(np.array([0.7, 0.1], np.float32))
        ends["running"] += 1
    return ends


@pytest.mark.slow
def test_mutated_snapshots_end_in_an_error_or_run() -> None:
    """In a process of its own, which a crash would end."""
    code = "import json; from tests.env.test_state_fuzz import run; print(json.dumps(run(0, 300)))"
    ends = json.loads(run_python(code, PYTHONWARNINGS="ignore"))
    assert sum(ends.values()) == 300
    assert min(ends.values()) > 0


def test_an_array_cut_to_nothing_and_another_class_are_refused() -> None:
    """It ended the process once: free(): invalid pointer."""
    env = started()
    state = env.get_state()
    grid = state["episode"]["@object"][1]["pipeline"]["@object"][1]["grid"]["@object"][1]
    array = grid["canvas"]["@object"][1]["grid"]["@object"][1]["room"]["@array"]
    array[0] = array[0][:0]
    with pytest.raises(StateError, match=r"room: expected size h = \d+, given 0"):
        env.set_state(state)
    for name in ("mecp_env.slam.messages:Belief", "mecp_env.core.settings:Settings"):
        state["episode"]["@object"][0] = name
        with pytest.raises(StateError):
            env.set_state(state)


def test_every_array_of_a_state_has_its_shape_declared() -> None:
    env = started(crowd={"people": 2})
    state, missing = env.get_state(), set()
    for part in ("moving", "episode"):
        for path in places(state[part]):
            node = at(state[part], path)
            if isinstance(node, dict) and "@object" in node:
                name, fields = node["@object"][0].split(":")[1], node["@object"][1]
                declared = {word.split(".")[0].removesuffix("[]") for word in SHAPES.get(name, {})}
                arrays = {field for field, item in fields.items() if isinstance(item, dict) and "@array" in item}
                missing |= {f"{name}.{field}" for field in arrays - declared}
    assert missing <= CHECKED_BY_HAND
