"""Every column of the observation has a name and a unit."""

from __future__ import annotations

from mecp_env.episode.observation_arrays import COLUMNS, PREDICTED
from mecp_env.episode.observations import make_space


def test_every_column_of_the_space_is_named() -> None:
    space = make_space(with_map=True, beams=720, max_range_m=30.0, uncertainty=True).spaces
    assert set(space) == set(COLUMNS)
    for name, box in space.items():
        assert box.shape is not None
        columns = {"grid": box.shape[0], "map": box.shape[0], "scan": 1}.get(name, box.shape[-1])
        assert len(COLUMNS[name]) == columns, name


def test_predicted_columns_of_goals_come_last() -> None:
    certain, uncertain = (make_space(False, 0, 30.0, uncertainty)["goals"].shape for uncertainty in (False, True))
    assert certain is not None
    assert uncertain is not None
    assert uncertain[1] - certain[1] == len(PREDICTED)
    assert COLUMNS["goals"][certain[1] :] == PREDICTED
