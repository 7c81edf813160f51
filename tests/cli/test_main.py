"""The command: files written, wrong input, interruption."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from PIL import Image
from rich.console import Console

import mecp_env
from mecp_env.cli import main as cli
from mecp_env.cli.demo import Demo
from mecp_env.cli.options import Fields, configuration
from mecp_env.cli.runs import BESIDE, Bar, Run, print_figures, status
from mecp_env.cli.stopwatch import Stopwatch
from mecp_env.config import EnvConfig
from mecp_env.env import MecpEnv
from mecp_env.evaluation.trajectory import tum
from mecp_env.floorplans import load_plan
from mecp_env.slam import SlamPipeline
from mecp_env.slam.config import SlamConfig
from mecp_env.world.outline import build_outline
from tests.cli.pipes import closed_pipe

Said = pytest.CaptureFixture[str]
FILES = {
    "map.png",
    "curves.png",
    "run.gif",
    "replay.html",
    "metrics.json",
    "trajectory.tum",
    "truth.tum",
    "config.json",
} | {f"belief.{ending}" for ending in ("yaml", "pgm", "svg")}
FIGURES = {
    "rooms",
    "rooms_found",
    "doors",
    "doors_found",
    "coverage",
    "grid_iou",
    "pose_rmse_m",
    "pose_error_final_m",
    "nees_mean",
    "map_rmse_m",
    "landmarks_false",
    "association_precision",
    "association_recall",
    "duplicates",
    "contacts",
    "periods",
    "metres",
    "steps_per_s",
    "us_per_period",
}


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a demo on the small layout."""
    folder = tmp_path_factory.mktemp("demo") / "run"
    line = ["demo", "--layout", "two_rooms", "--seed", "3", "--out", str(folder)]
    assert cli.main([*line, "--save-map", str(folder.parent / "map.zip")]) == 0
    return folder


def test_the_demo_leaves_its_nine_files(kept: Path) -> None:
    assert {path.name for path in kept.iterdir()} == FILES


def test_a_demo_whose_reader_is_gone_keeps_its_files(tmp_path: Path, capsys: Said) -> None:
    """`demo | head -1` once ended at the first line that it could not print, and wrote nothing."""
    with closed_pipe():
        assert cli.main(["demo", "--layout", "two_rooms", "--no-replay", "--out", str(tmp_path)]) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES - {"replay.html"}
    assert capsys.readouterr().err.count("the output pipe is closed") == 1


@pytest.fixture(scope="module")
def explored() -> Run:
    run = Run(MecpEnv(EnvConfig.build(layout="two_rooms", max_steps=40)), seed=3)
    run.explore(lambda _: None)
    return run


@pytest.mark.parametrize(
    ("bytes_left", "name"),
    [(300, "metrics.json"), (12_000, "belief.pgm"), (20_000, "belief.svg"), (100_000, "map.png")],
)
def test_a_full_disk_names_the_file_and_keeps_the_data(
    bytes_left: int, name: str, explored: Run, tmp_path: Path
) -> None:
    """Libraries raise errors that name no file. Here a file can have no more than some bytes."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_left, hard))
    try:
        with pytest.raises(OSError, match="too large") as error:
            explored.keep(tmp_path, Stopwatch())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert error.value.filename == str(tmp_path / name)
    if name != "metrics.json":
        assert {"metrics.json", "config.json", "trajectory.tum", "truth.tum"} <= {p.name for p in tmp_path.iterdir()}


def test_the_map_of_a_demo_continues_where_it_ended(kept: Path) -> None:
    pipeline = SlamPipeline.from_map(kept.parent / "map.zip")
    x, y = np.loadtxt(kept / "trajectory.tum")[-1, 1:3]
    assert pipeline.filter.belief().T_map_robot[:2] == pytest.approx([x, y], abs=1e-6)


def test_the_believed_map_can_be_read_and_is_small(kept: Path) -> None:
    layout = load_plan(kept / "belief.yaml")
    assert (len(layout.rooms), len(layout.doors)) == (2, 1)
    x, y = np.loadtxt(kept / "trajectory.tum")[:, 1:3].T
    assert shapely.contains_xy(build_outline(layout).free_area, x, y).all()  # both are in the map frame
    assert sum(path.stat().st_size for path in kept.glob("belief.*")) < 100_000


def test_a_run_does_not_overwrite_the_plan_that_it_explores(kept: Path, capsys: Said) -> None:
    before = (kept / "belief.pgm").read_bytes()
    assert cli.main(["demo", "--layout", str(kept / "belief.yaml"), "--out", str(kept)]) == 2
    assert "name another file" in capsys.readouterr().err
    assert (kept / "belief.pgm").read_bytes() == before


def test_the_demo_explores_the_small_layout_completely(kept: Path) -> None:
    metrics = json.loads((kept / "metrics.json").read_text())
    assert metrics.keys() >= FIGURES
    assert metrics["ended"] == "complete"
    assert (metrics["rooms_found"], metrics["doors_found"]) == (2, 1)
    assert metrics["coverage"] > 0.95
    assert all(np.isfinite(value) for value in metrics["us_per_period"].values())


def test_one_of_a_kind_is_told_as_one(kept: Path, capsys: Said) -> None:
    print_figures("", json.loads((kept / "metrics.json").read_text()) | {"duplicates": 1.0, "contacts": 1.0}, kept)
    said = capsys.readouterr().out
    assert "duplicates 1 " in said
    assert "contacts 1 " in said


def test_a_folder_of_a_run_is_told_as_that_with_the_map_in_it(kept: Path, capsys: Said) -> None:
    for line in (["worlds", "draw", str(kept)], ["demo", "--layout", str(kept)]):
        assert cli.main(line) == 2
        said = capsys.readouterr().err
        assert f"{kept} holds a run, not buildings; the believed map of it is {kept / 'belief.yaml'}" in said
        assert said.count("\n") == 1


def test_the_paths_are_read_as_tum_and_lie_close_together(kept: Path) -> None:
    estimated, true = (np.loadtxt(kept / name) for name in ("trajectory.tum", "truth.tum"))
    steps = json.loads((kept / "metrics.json").read_text())["periods"]
    assert estimated.shape == true.shape == (steps + 1, 8)
    assert np.diff(true[:, 0]) == pytest.approx(0.4)
    assert np.linalg.norm(true[:, 4:], axis=1) == pytest.approx(1.0)
    assert np.abs(estimated[:, 1:3] - true[:, 1:3]).max() < 0.3


def test_the_pictures_can_be_opened(kept: Path) -> None:
    with Image.open(kept / "run.gif") as film, Image.open(kept / "map.png") as picture:
        assert film.n_frames > 3
        assert picture.size[0] > 1000


def test_the_recipe_reproduces_the_run(kept: Path, tmp_path: Path) -> None:
    recipe = json.loads((kept / "config.json").read_text())
    run = Run(MecpEnv(EnvConfig.build(recipe["config"])), recipe["seed"])
    run.explore(lambda run: None)
    assert tum(0.4 * np.arange(len(run.estimated)), run.estimated) == (kept / "trajectory.tum").read_text()
    steps = json.loads((kept / "metrics.json").read_text())["periods"]
    assert run.env.view().title == f"two_rooms, slam, step {steps}"  # the title of map.png


def test_the_run_can_be_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    line = ["demo", "--layout", "two_rooms", "--render", "human", "--config.max-steps", "6"]
    assert cli.main([*line, "--out", str(tmp_path / "run")]) == 0
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["ended"] == "out of steps"


def test_an_interruption_keeps_what_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    look = Run.look

    def look_and_stop(run: Run, info: dict[str, Any] | None = None) -> None:
        look(run, info)
        if run.steps == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(Run, "look", look_and_stop)
    assert cli.main(["demo", "--layout", "two_rooms", "--out", str(tmp_path / "run")]) == 130
    assert {path.name for path in (tmp_path / "run").iterdir()} == FILES
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert (metrics["ended"], metrics["periods"]) == ("interrupted", 5)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ([], "demo"),
        (["dance"], "dance"),
        (["demo", "--seed", "first"], "first"),
        (["demo", "--config.slam.filter.kindd", "ekf"], "--config.slam.filter.kind"),
        (["demo", "--config.slam.filter.kind", "ukf"], "riekf"),
        (["demo", "--config.max-steps", "0"], "Error parsing config: --config.max_steps: Input"),
        (["demo", "--render", "holo"], "human"),
    ],
)
def test_a_wrong_line_ends_with_2_and_says_why(line: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(line)
    assert ended.value.code == 2
    streams = capsys.readouterr()
    assert said in streams.err + streams.out


@pytest.mark.parametrize("command", ["demo", "one-scan"])
@pytest.mark.parametrize(
    ("layout", "said"),
    [
        ("easy:0-3", "layout: easy:0-3 is 4 buildings; name one building, as easy:0"),
        ("plans", "layout: plans is 2 buildings; name one building, as plans/a.json"),
        ("", "''"),
        ("easy", "easy: which buildings?"),
    ],
)
def test_a_word_for_several_buildings_or_none_is_refused(
    command: str, layout: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plans").mkdir()
    for name in ("a", "b"):
        (tmp_path / "plans" / f"{name}.json").touch()
    assert cli.main([command, "--layout", layout]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"mecp-env: {said}")
    assert told.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["plans"]


def test_an_unknown_layout_ends_with_2_and_names_the_shipped_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["demo", "--layout", "castle", "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "castle" in said
    assert "two_rooms" in said
    assert not (tmp_path / "run").exists()


def test_a_negative_seed_and_a_missing_display_end_with_2_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["demo", "--layout", "two_rooms", "--out", str(tmp_path / "run")]
    assert cli.main([*line, "--seed", "-1"]) == 2
    assert capsys.readouterr().err == "mecp-env: --seed: Input should be greater than or equal to 0 (given: -1)\n"
    monkeypatch.setenv("SDL_VIDEODRIVER", "none_such")
    assert cli.main([*line, "--render", "human"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mecp-env: render_mode: 'human' can open no window")
    assert said.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_machine_without_a_display_is_told_from_a_window_nobody_sees(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    monkeypatch.setattr("pygame.display.get_driver", lambda: "offscreen")  # SDL's fallback without a display
    monkeypatch.chdir(tmp_path)
    assert cli.main(["demo", "--layout", "two_rooms", "--render", "human"]) == 2
    said = capsys.readouterr().err
    assert "there is no display" in said
    assert "DISPLAY" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("line", "code", "said"),
    [
        (["--help"], 0, "one-scan"),
        (["--version"], 0, mecp_env.__version__),
        (["dmo"], 2, "did you mean `mecp-env demo`?"),
        (["demo", "--help"], 0, "mecp-env demo --layout office"),
        (["one-scan", "--help"], 0, "mecp-env one-scan --layout office"),
    ],
)
def test_help_shows_examples_and_the_nearest_command(
    line: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(line)
    assert ended.value.code == code
    streams = capsys.readouterr()
    assert said in streams.err + streams.out


def test_every_command_can_be_loaded_and_has_examples() -> None:
    for words in cli.COMMANDS:
        assert all(example.startswith(f"mecp-env {words}") for example in cli.load(words).examples)
        assert cli.load(words).examples


def test_the_overview_loads_no_command() -> None:
    code = "import sys; from mecp_env.cli import main; main.overview(''); print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.split())
    assert "mecp_env.cli.base" in loaded
    assert not {"tyro", "numba", "pygame", "matplotlib", "shapely", "mecp_env.config"} & loaded


def test_ctrl_c_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("mecp_env.cli.demo.recognition", stop)
    assert cli.main(["one-scan"]) == 130


def test_a_folder_that_cannot_be_made_ends_with_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert cli.main(["demo", "--layout", "two_rooms", "--out", str(tmp_path / "file" / "run")]) == 2
    assert "file" in capsys.readouterr().err


def test_only_changed_fields_are_set_so_that_the_rest_follows_the_laser() -> None:
    fields = Fields(laser={"preset": "lms200"}, slam=SlamConfig(filter={"kind": "ekf"}))
    line = ["--config.laser.preset", "lms200", "--config.slam.filter.kind=ekf"]
    config = configuration("office", fields, line)
    assert (config.layout, config.slam.filter.kind) == ("office", "ekf")
    assert config.estimator_config.sensor.range_sigma_m == pytest.approx(0.01)
    assert configuration("two_rooms", Fields(), []) == EnvConfig(layout="two_rooms")


def test_a_field_set_to_its_default_is_set() -> None:
    line = "demo --config.laser.preset ideal --config.slam.sensor.range-sigma-m 0.05"
    words, options = cli.split([*line.split(), "--config.slam.polygon.no-check-walls"])
    chosen = cli.parse(words, options)
    assert isinstance(chosen, Demo)
    config = configuration("paper", chosen.config, options)
    assert config.estimator_config.sensor.range_sigma_m == 0.05
    assert config.estimator_config.sensor.bearing_sigma_deg == 0.0  # follows the laser
    assert not config.slam.polygon.check_walls


def test_the_progress_shows_everything_in_80_columns() -> None:
    metrics = {"rooms_found": 12, "rooms": 12, "doors_found": 12, "doors": 12, "coverage": 1.0, "pose_error_m": 1.234}
    out = io.StringIO()
    with Bar("exploring", 1.0, *BESIDE, console=Console(file=out, width=80, force_terminal=True)) as bar:
        bar.show(10, lambda: (1.0, status(metrics, 12345.0)))
    assert "rooms 12/12 doors 12/12 seen 100.0% error 123.4 cm 12,345 steps/s" in out.getvalue()


def test_one_scan_draws_a_picture_a_stage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["one-scan", "--layout", "two_rooms", "--step", "3", "--out", str(tmp_path)]
    assert cli.main(line) == 0
    assert len(list(tmp_path.glob("*.png"))) == 6
    assert cli.main([*line[:4], "99999", *line[5:]]) == 2
    assert "step" in capsys.readouterr().err


@pytest.mark.slow
def test_one_scan_takes_the_buildings_that_the_demo_takes(tmp_path: Path, capsys: Said) -> None:
    assert cli.main(["worlds", "convert", "two_rooms", str(tmp_path / "plan.yaml")]) == 0
    for layout in ("easy:3", str(tmp_path / "plan.yaml")):
        assert cli.main(["one-scan", "--layout", layout, "--step", "3", "--out", str(tmp_path / "scan")]) == 0
        assert capsys.readouterr().out.endswith("6-association.png\n")


def test_one_scan_refuses_a_step_below_0(capsys: Said) -> None:
    assert cli.main(["one-scan", "--step", "-5"]) == 2
    assert capsys.readouterr().err == "mecp-env: --step: Input should be greater than or equal to 0 (given: -5)\n"


@pytest.mark.parametrize("module", ["mecp_env", "mecp_env.cli.main"])
def test_the_command_runs_as_a_module(module: str) -> None:
    done = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert "one-scan" in done.stdout
