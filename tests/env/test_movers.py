"""Dynamic obstacles in the environment: closed doors, and what the summary says of them."""

from tests.env.helpers import make, world_of


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
