"""The command: files written, wrong input, interruption."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import Image

from mecp_env.cli import main as cli
from mecp_env.cli.demo import Demo
from mecp_env.cli.options import configuration
from mecp_env.cli.runs import Run
from mecp_env.config import EnvConfig
from mecp_env.env import MecpEnv
from mecp_env.floorplans import load_plan
from mecp_env.render.replay_page import read_page
from mecp_env.slam import SlamPipeline
from mecp_env.world.outline import build_outline
from tests.cli.pipes import closed_pipe

Said = pytest.CaptureFixture[str]
DATA = {"metrics.json", "trajectory.tum", "truth.tum", "config.json"}
FILES = {*DATA, "map.png", "curves.png", "run.gif", "replay.html", "belief.yaml", "belief.pgm", "belief.svg"}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a demo on the small layout."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    line = ["demo", "--layout", "two_rooms", "--seed", "3", "--out", str(folder)]
    assert cli.main([*line, "--save-map", str(folder.parent / "map.zip")]) == 0
    return folder


def metrics_of(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "metrics.json").read_text())


def test_the_demo_explores_the_small_layout_and_leaves_its_files(kept: Path) -> None:
    assert {path.name for path in kept.iterdir()} == FILES
    metrics = metrics_of(kept)
    assert metrics["ended"] == "complete"
    assert (metrics["rooms_found"], metrics["doors_found"]) == (2, 1)
    assert metrics["coverage"] > 0.95
    with Image.open(kept / "run.gif") as film, Image.open(kept / "map.png") as picture:
        assert film.n_frames > 3
        assert picture.size[0] > 1000


def test_the_paths_the_believed_map_and_the_saved_map_agree(kept: Path) -> None:
    estimated, true = (np.loadtxt(kept / name) for name in ("trajectory.tum", "truth.tum"))
    assert estimated.shape == true.shape == (metrics_of(kept)["periods"] + 1, 8)
    assert np.diff(true[:, 0]) == pytest.approx(0.4)
    assert np.linalg.norm(true[:, 4:], axis=1) == pytest.approx(1.0)
    assert np.abs(estimated[:, 1:3] - true[:, 1:3]).max() < 0.3
    layout = load_plan(kept / "belief.yaml")
    assert (len(layout.rooms), len(layout.doors)) == (2, 1)
    assert shapely.contains_xy(build_outline(layout).free_area, *estimated[:, 1:3].T).all()  # both in the map frame
    assert sum(path.stat().st_size for path in kept.glob("belief.*")) < 100_000
    pipeline = SlamPipeline.from_map(kept.parent / "map.zip")
    assert pipeline.filter.belief().T_map_robot[:2] == pytest.approx(estimated[-1, 1:3], abs=1e-6)


def test_a_page_gets_the_player_of_this_version_and_a_run_without_one_is_explored_again(
    kept: Path, tmp_path: Path, capsys: Said
) -> None:
    page, wanted = kept / "replay.html", read_page(kept / "replay.html")
    before = page.read_text()
    page.write_text(before.replace("Pause", "Halt"))
    assert cli.main(["replay", str(kept)]) == 0
    assert page.read_text() == before
    assert f"frames: {page}" in capsys.readouterr().out
    page.rename(tmp_path / "page.html")
    try:
        assert cli.main(["replay", str(kept), "--out", str(tmp_path / "again.html")]) == 0
    finally:
        (tmp_path / "page.html").rename(page)
    assert read_page(tmp_path / "again.html") == wanted


def test_no_export_is_written_over_another_nor_without_a_name(kept: Path, tmp_path: Path, capsys: Said) -> None:
    image, sheet = tmp_path / "a.pgm", tmp_path / "." / "a.yaml"  # which has an image of its name
    for options, said in (("--landmarks", str(image), "--grid", str(sheet)), "name another file"), ((), "--landmarks"):
        assert cli.main(["export", str(kept.parent / "map.zip"), *options]) == 2
        assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))


def test_a_folder_of_a_run_is_told_as_that_and_its_map_is_not_overwritten(kept: Path, capsys: Said) -> None:
    before = (kept / "belief.pgm").read_bytes()
    told = f"{kept} holds a run, not buildings; the believed map of it is {kept / 'belief.yaml'}\n"
    for line, said in {
        ("worlds", "draw", str(kept)): told,
        ("demo", "--layout", str(kept)): told,
        ("demo", "--layout", str(kept / "belief.yaml"), "--out", str(kept)): "name another file\n",
    }.items():
        assert cli.main([*line]) == 2
        err = capsys.readouterr().err
        assert err.endswith(said)
        assert err.count("\n") == 1
    assert (kept / "belief.pgm").read_bytes() == before


@pytest.mark.usefixtures("blank_figures")
def test_a_demo_whose_reader_is_gone_keeps_its_files(tmp_path: Path, capsys: Said) -> None:
    """`demo | head -1` once ended at the first line that it could not print, and wrote nothing."""
    (tmp_path / "replay.html").write_text("of an earlier run")
    line = ["demo", "--layout", "two_rooms", "--no-replay", "--config.max-steps", "30", "--out", str(tmp_path)]
    with closed_pipe():
        assert cli.main(line) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES - {"replay.html"}
    assert not capsys.readouterr().err


def test_an_evaluation_whose_reader_is_gone_is_completed(tmp_path: Path) -> None:
    """`evaluate 2>&1 | head -2` once ended at the third line of its progress."""
    line = ["evaluate", "nearest", "--layout", "two_rooms", "--episodes", "3", "--no-truth", "--max-steps", "5"]
    with closed_pipe():
        assert cli.main([*line, "--out", str(tmp_path)]) == 0
    assert (tmp_path / "results.json").exists()


@pytest.fixture(scope="module")
def explored() -> Run:
    run = Run(MecpEnv(EnvConfig.build(layout="two_rooms", max_steps=40)), seed=3)
    run.explore()
    return run


def keep(run: Run, folder: Path) -> None:
    """Write all files of a run."""
    run.keep_data(folder)
    run.keep_pictures(folder)


@pytest.mark.parametrize(("bytes_left", "name"), [(300, "metrics.json"), (12_000, "belief.pgm"), (40_000, "map.png")])
def test_a_full_disk_names_the_file_and_keeps_the_data(
    bytes_left: int, name: str, explored: Run, tmp_path: Path
) -> None:
    """Libraries raise errors that name no file. Here a file can have no more than some bytes."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_left, hard))
    try:
        with pytest.raises(OSError, match="too large") as error:
            keep(explored, tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert error.value.filename == str(tmp_path / name)
    assert name == "metrics.json" or {p.name for p in tmp_path.iterdir()} >= DATA


@pytest.mark.usefixtures("blank_figures")
def test_the_run_can_be_watched_and_an_interruption_keeps_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    look = Run.look

    def look_and_stop(run: Run, info: dict[str, Any] | None = None) -> None:
        look(run, info)
        if run.steps == 5:
            raise KeyboardInterrupt

    line = ["demo", "--layout", "two_rooms", "--render", "human", "--config.max-steps", "6", "--out"]
    assert cli.main([*line, str(tmp_path / "whole")]) == 0
    assert metrics_of(tmp_path / "whole")["ended"] == "out of steps"
    monkeypatch.setattr(Run, "look", look_and_stop)
    assert cli.main([*line, str(tmp_path / "run")]) == 130
    assert {path.name for path in (tmp_path / "run").iterdir()} == FILES
    assert (metrics_of(tmp_path / "run")["ended"], metrics_of(tmp_path / "run")["periods"]) == ("interrupted", 5)


def test_a_machine_without_a_display_is_told_from_a_window_nobody_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.setattr("pygame.display.get_driver", lambda: "offscreen")  # SDL's fallback without a display
    monkeypatch.chdir(tmp_path)
    assert cli.main(["demo", "--layout", "two_rooms", "--render", "human"]) == 2
    said = capsys.readouterr().err
    assert "there is no display" in said
    assert "DISPLAY" in said
    assert list(tmp_path.iterdir()) == []


def test_the_overview_loads_no_command_and_the_package_runs_as_a_module() -> None:
    code = "import sys; from mecp_env.cli import main; main.overview(''); print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.split())
    assert "mecp_env.cli.base" in loaded
    assert not {"tyro", "numba", "pygame", "matplotlib", "shapely", "mecp_env.config"} & loaded
    for module in ("mecp_env", "mecp_env.cli.main"):
        done = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True, check=True)
        assert "one-scan" in done.stdout


def test_a_field_set_to_its_default_is_set() -> None:
    line = "demo --config.laser.preset ideal --config.slam.sensor.range-sigma-m 0.05"
    words, options = cli.split([*line.split(), "--config.slam.polygon.no-check-walls"])
    chosen = cli.parse(words, options)
    assert isinstance(chosen, Demo)
    config = configuration("paper", chosen.config, options)
    assert config.estimator_config.sensor.range_sigma_m == 0.05
    assert config.estimator_config.sensor.bearing_sigma_deg == 0.0  # follows the laser
    assert not config.slam.polygon.check_walls
