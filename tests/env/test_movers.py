"""Dynamic obstacles in the environment: seeds, snapshots, closed doors, rendering."""

import numpy as np
import pytest

from mecp_env.core.snapshot import StateError
from tests.env.helpers import drive, make, same, world_of

BUSY = {"crowd": {"people": 4}, "clutter": {"movable_boxes": 3, "closed_doors": 0.3}, "layout": "paper"}


def test_the_seed_says_what_moves_and_a_state_of_it_with_a_torn_array_is_refused() -> None:
    one, two, other = make(**BUSY), make(**BUSY), make(**BUSY)
    for env, seed in ((one, 1), (two, 1), (other, 2)):
        env.reset(seed=seed)
    a, b, c = (world_of(env).movers.state for env in (one, two, other))
    assert same(a.pedestrians, b.pedestrians)
    assert not same(a.pedestrians, c.pedestrians)
    assert same(drive(one, 40), drive(two, 40))
    torn = one.unwrapped.get_state()
    torn["moving"]["@object"][1]["pedestrians"]["@array"][0] = np.zeros((2, 3))
    with pytest.raises(StateError, match="moving"):
        two.unwrapped.set_state(torn)


def test_rooms_behind_closed_doors_do_not_count() -> None:
    env = make(clutter={"closed_doors": 1.0, "reachable_share": 0.0})
    _, info = env.reset(seed=0)
    assert info["rooms"] == 1
    assert info["doors"] == 0
    free = world_of(env).truth.free_cells
    open_env = make()
    open_env.reset(seed=0)
    assert free < 0.7 * world_of(open_env).truth.free_cells
    assert env.reset(options={"start": (8.0, 3.0, 0.0)})[1]["rooms"] == 1


def test_the_summary_tells_how_many_found_room() -> None:
    """Seen: fewer than the requested 50 pedestrians and 50 boxes fitted in two rooms, and this was not reported."""
    crowded = {"crowd": {"people": 50}, "clutter": {"movable_boxes": 50, "closed_doors": 1.0, "reachable_share": 0.0}}
    env = make(**crowded)
    env.reset(seed=0)
    moving, told = world_of(env).movers.state, env.unwrapped.summary()
    assert (told["people"], told["boxes"]) == (len(moving.pedestrians), len(moving.boxes))
    assert 0 < told["people"] + told["boxes"] < 100
    assert (told["closed_doors"], told["rooms"], told["rooms_cut_off"]) == (1, 1, 1)
    twin = make(**crowded)
    twin.unwrapped.set_state(env.unwrapped.get_state())
    assert twin.unwrapped.summary() == told
