"""Recordings of the rerun viewer: what is in them, and where they cannot be made."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.cli.main import main
from mecp_env.env import MecpEnv
from mecp_env.render.rerun_log import RerunLog

STEPS = 12


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], list[Any]]:
    """What was logged last of every entity, and the views that it was made of."""
    pytest.importorskip("rerun", reason="needs the extra viewer")
    path = tmp_path_factory.mktemp("rerun") / "new" / "run.rrd"
    env, log, views, logged = MecpEnv(), RerunLog(path), list[Any](), dict[str, Any]()
    env.reset(seed=1)
    write = log.stream.log

    def spy(name: str, what: Any, **options: Any) -> None:
        logged[name] = what
        write(name, what, **options)

    log.stream.log = spy
    for _ in range(STEPS):
        info = env.step(np.array([0.5, 0.2]))[4]
        views.append(env.view())
        log.look(views[-1], info)
    log.close()
    assert path.stat().st_size > 10_000
    return logged, views


def last(logged: dict[str, Any], entity: str, column: str) -> Any:
    """What an entity has in a column, as plain data."""
    return getattr(logged[entity], column).as_arrow_array().to_pylist()


def test_everything_shown_is_that_of_the_estimator(kept: tuple[dict[str, Any], list[Any]]) -> None:
    logged, views = kept
    output = views[-1].slam_output
    assert np.allclose(np.array(last(logged, "belief/landmarks", "positions"))[:, :2], output.belief.p_map, atol=1e-5)
    assert last(logged, "belief/landmarks", "labels") == [str(name) for name in output.belief.ids]
    reasons = last(logged, "belief/robot/laser/corners", "labels")
    assert len(reasons) == len(output.corners)
    assert all(": " in reason for reason in reasons)
    error = last(logged, "curves/error/pose_error_m", "scalars")
    assert error == pytest.approx([views[-1].metrics["pose_error_m"]])
    assert np.allclose(last(logged, "belief/robot", "translation")[0][:2], output.belief.T_map_robot[:2], atol=1e-5)
    (ring,) = np.array(last(logged, "belief/pose_ellipse", "strips"))[:, :, :2] - output.belief.T_map_robot[:2]
    distances = np.einsum("ni,ij,nj->n", ring, np.linalg.inv(output.belief.pose_cov[:2, :2]), ring)
    assert distances == pytest.approx(5.991, rel=0.02)
    grid = views[-1].slam_output.grid
    image = np.array(last(logged, "belief/grid", "data"), np.uint8).reshape(*grid.label.shape, 3)
    seen = (image != image[0, 0]).any(axis=2)  # the corner of the grid is unknown
    assert np.array_equal(seen[::-1], grid.label > 0)
    assert np.allclose(last(logged, "belief/grid", "translation")[0][:2], grid.origin, atol=1e-5)


def test_commands_write_one_and_refuse_a_wrong_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rerun", reason="needs the extra viewer")
    demo, explore = ["demo", "--no-replay", "--out", str(tmp_path / "kept")], ["explore", "nearest"]
    for line, made in ((demo, tmp_path / "demo.rrd"), (explore, tmp_path / "explore.rrd")):
        assert main([*line, "--layout", "two_rooms", "--rerun", str(made)]) == 0
        assert made.stat().st_size > 50_000
        assert f"recording: {made}" in " ".join(capsys.readouterr().out.split())
    (tmp_path / "folder.rrd").mkdir()
    for wrong, words in (("run.txt", "--rerun.* name that ends in .rrd"), ("folder.rrd", "is a folder, not a file")):
        assert main([*explore, "--rerun", str(tmp_path / wrong)]) == 2
        assert re.search(words, " ".join(capsys.readouterr().err.split()))


def test_without_rerun_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    made = tmp_path / "run.rrd"
    assert main(["demo", "--layout", "two_rooms", "--out", str(tmp_path / "kept"), "--rerun", str(made)]) == 2
    assert "pip install 'mecp_env[viewer]'" in " ".join(capsys.readouterr().err.split())
    assert not made.exists()
    assert not (tmp_path / "kept").exists()
