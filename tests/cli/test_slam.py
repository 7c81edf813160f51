"""`mecp-env slam`: a drive through two rooms as a log, mapped, localised in its map, and everything that is wrong."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.cli import main as cli
from mecp_env.cli import runs
from mecp_env.evaluation import log_run
from mecp_env.floorplans import load_plan
from mecp_env.slam.map_file import SlamMap
from mecp_env.slam.pipeline import SlamPipeline
from tests.logs.files import write_archive, write_bag, write_carmen
from tests.logs.simulated import write_simulated

pytestmark = pytest.mark.usefixtures("draft_figures")

Said = pytest.CaptureFixture[str]
FILES = (
    {"map.png", "run.gif", "replay.html", "metrics.json", "trajectory.tum", "truth.tum", "config.json"}
    | {f"belief.{ending}" for ending in ("yaml", "pgm", "svg")}
    | {f"{name}_final.{ending}" for name, ending in (("trajectory", "tum"), ("landmarks", "csv"), ("map", "png"))}
    | {"belief_final.yaml", "belief_final.pgm"}
)


@pytest.fixture(scope="module", autouse=True)
def short_films() -> Iterator[None]:
    """Films of a few frames: to draw them is most of the time of a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "FRAMES", 20)
        yield


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_simulated(tmp_path_factory.mktemp("logs") / "rooms.npz")


@pytest.fixture(scope="module")
def kept(log: Path) -> Path:
    """The files of a run on that log."""
    folder = log.parent / "run"
    assert cli.main(["slam", str(log), "--out", str(folder), "--save-map", str(log.parent / "map.zip")]) == 0
    return folder


def metrics_of(folder: Path) -> dict[str, object]:
    return json.loads((folder / "metrics.json").read_text())


def changed(log: Path, path: Path, **change: Any) -> Path:
    """The log with arrays in place of some; None leaves one out."""
    with np.load(log) as whole:
        arrays = {name: change.get(name, whole[name]) for name in whole}
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
    return path


def test_a_log_becomes_a_map(kept: Path) -> None:
    assert {path.name for path in kept.iterdir()} == FILES
    metrics = metrics_of(kept)
    assert (metrics["ended"], metrics["rooms"], metrics["doors"]) == ("complete", 2, 1)
    assert metrics["ate_m"] < 0.05 < metrics["dead_reckoning_ate_m"]
    assert metrics["final_converged"]
    assert metrics["final_ate_m"] < 0.05
    assert len(load_plan(kept / "belief.yaml").rooms) == len(load_plan(kept / "belief_final.yaml").rooms) == 2
    assert len((kept / "landmarks_final.csv").read_text().splitlines()) == 1 + metrics["landmarks"]
    names = "trajectory.tum", "trajectory_final.tum", "truth.tum"
    estimated, final, reference = (np.loadtxt(kept / name) for name in names)  # in one frame
    np.testing.assert_array_equal(estimated[:, 0], reference[:, 0])
    np.testing.assert_array_equal(final[:, 0], reference[:, 0])
    assert np.hypot(*(estimated - reference)[:, 1:3].T).max() < 0.2
    assert np.hypot(*(final - reference)[:, 1:3].T).max() < 0.2
    assert (final != estimated).any()


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_calibration_is_kept_and_printed(kept: Path, log: Path, tmp_path: Path, capsys: Said) -> None:
    calibration = metrics_of(kept)["calibration"]
    assert calibration["registered"] <= calibration["tried"]
    recipe = json.loads((kept / "config.json").read_text())
    for name, found in calibration["fields"].items():
        of_sensor = name in ("x_m", "heading_deg", "range_sigma_m")
        assert found["value"] == (recipe["config"]["sensor"] if of_sensor else recipe["odometry"])[name]
    line = ["slam", str(log), "--out", str(tmp_path / "run"), "--rest-m", "0.5", "--rest-deg", "45"]
    given = ["--noise.distance-scale", "1.05", "--noise.turn-sigma-deg", "3", "--config.sensor.x-m", "0.02"]
    assert cli.main([*line, *given]) == 0
    assert "calibration by" in capsys.readouterr().out
    fields = metrics_of(tmp_path / "run")["calibration"]["fields"]
    assert [fields[name]["value"] for name in ("distance_scale", "turn_sigma_deg", "x_m")] == [1.05, 3.0, 0.02]
    assert fields["distance_scale"]["source"] == "given"
    assert cli.main([*line, "--noise", "paper", "--noise.turn-scale", "1.1"]) == 2
    assert "turn_scale given" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_the_pose_is_found_in_a_saved_map(kept: Path, log: Path) -> None:
    folder = log.parent / "again"
    line = ["slam", str(log), "--out", str(folder), "--from-map", str(log.parent / "map.zip"), "--start"]
    assert cli.main([*line, "unknown"]) == 0
    metrics = metrics_of(folder)
    assert metrics["localised_share"] > 0.9
    assert metrics["ate_m"] < 0.05
    assert (metrics["rooms"], metrics["doors"]) == (2, 1)
    assert [cli.main([*line, place]) for place in ("here", "nan,0,0")] == [2, 2]


@pytest.mark.slow
@pytest.mark.usefixtures("blank_figures")
def test_a_mirrored_laser_is_named(log: Path, tmp_path: Path, capsys: Said, monkeypatch: pytest.MonkeyPatch) -> None:
    with np.load(log) as whole:
        changed(log, tmp_path / "a.npz", angles=-whole["angles"])
    monkeypatch.setattr(log_run, "fault_of", lambda run, options: "of no use")
    assert cli.main(["slam", str(tmp_path / "a.npz"), "--out", str(tmp_path / "a")]) == 1
    said = capsys.readouterr()
    assert "try --mirror" in said.out
    assert "of no use; the laser seems to be mirrored" in said.err
    assert any("--mirror" in note for note in metrics_of(tmp_path / "a")["notes"])


@pytest.mark.usefixtures("blank_figures")
def test_options_reach_the_estimator(log: Path, tmp_path: Path) -> None:
    line = (
        "--odometry reference --seed 3 --config.sensor.range-sigma-m 0.07 --noise.scale 0.5 --rest-m 0.3 --rest-deg 40"
    )
    assert cli.main(["slam", str(log), "--out", str(tmp_path), *line.split()]) == 0
    recipe = json.loads((tmp_path / "config.json").read_text())
    assert recipe["config"]["sensor"]["range_sigma_m"] == 0.07
    assert recipe["config"]["sensor"]["field_of_view_deg"] == 360.0
    assert recipe["run"]["noise"]["scale"] == 0.5
    assert recipe["run"]["seed"] == 3
    assert metrics_of(tmp_path)["counts"]["scans at rest, skipped"] > 5


@pytest.mark.usefixtures("blank_figures")
def test_a_truncated_log_is_mapped_as_far_as_it_goes_and_two_topics_reach_the_reader(
    tmp_path: Path, capsys: Said
) -> None:
    path = write_carmen(tmp_path / "a.log")
    path.write_bytes(path.read_bytes()[:-300])
    assert cli.main(["slam", str(path), "--out", str(tmp_path / "a"), "--noise", "paper"]) == 0
    assert "counted: 1 damaged lines" in capsys.readouterr().out
    assert metrics_of(tmp_path / "a")["counts"] == {"damaged lines": 1}
    assert not (tmp_path / "a" / "truth.tum").exists()
    pytest.importorskip("rosbags")
    bag = write_bag(tmp_path / "b.bag", scan_topics=("/front", "/rear"))
    line = ["slam", str(bag), "--out", str(tmp_path / "b"), "--noise", "paper"]
    assert cli.main(line) == 2
    assert cli.main([*line, "--scan-topic", "/front", "--scan-topic", "/rear"]) == 0


def test_what_cannot_be_mapped_is_one_line(log: Path, kept: Path, tmp_path: Path, capsys: Said) -> None:
    saved, carmen = str(log.parent / "map.zip"), write_carmen(tmp_path / "a.log")
    small = ["--config.sensor.range-sigma-m", "0.1"]
    for said, source, more in (
        ("no ranges in the archive", write_archive(tmp_path / "a.npz", ranges=None), []),
        ("name one by --from-map", log, ["--start", "unknown"]),
        ("a map has its own configuration", log, ["--from-map", saved, *small]),
        ("name another file", log, ["--save-map", str(log)]),
        ("--scan-topic", carmen, ["--scan-topic", "FLASE"]),
    ):
        assert cli.main(["slam", str(source), "--out", str(tmp_path / "run"), *more]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
        assert not (tmp_path / "run").exists()


@pytest.mark.usefixtures("blank_figures")
def test_a_run_that_used_few_scans_fails_with_what_to_try(log: Path, tmp_path: Path, capsys: Said) -> None:
    with np.load(log) as whole:
        still = {name: np.repeat(whole[name][:1], 20, axis=0) for name in ("ranges", "odo", "ref")}
        changed(log, tmp_path / "a.npz", odo=0.0 * whole["odo"])
        changed(log, tmp_path / "b.npz", t=whole["t"][:20], **still)
    assert cli.main(["slam", str(tmp_path / "a.npz"), "--out", str(tmp_path / "a")]) == 1
    said = capsys.readouterr().err
    assert "at rest by its odometry" in said
    assert "--odometry none" in said
    assert metrics_of(tmp_path / "a")["scans"] == 1
    assert cli.main(["slam", str(tmp_path / "b.npz"), "--out", str(tmp_path / "b"), "--odometry", "none"]) == 1
    assert "at rest by its scans in 19: a map takes a drive" in capsys.readouterr().err
    assert metrics_of(tmp_path / "b")["counts"]["scans at rest, skipped"] == 19


@pytest.mark.usefixtures("blank_figures")
def test_after_ctrl_c_the_map_so_far_is_kept(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    step, steps = SlamPipeline.step, []

    def interrupted(self: SlamPipeline, *args: object) -> object:
        steps.append(args)
        if len(steps) == 20:
            raise KeyboardInterrupt
        return step(self, *args)

    monkeypatch.setattr(SlamPipeline, "step", interrupted)
    out, saved = tmp_path / "run", tmp_path / "map.zip"
    assert cli.main(["slam", str(log), "--out", str(out), "--save-map", str(saved), "--noise", "paper"]) == 130
    assert metrics_of(out)["ended"] == "interrupted"
    assert metrics_of(out)["scans"] == 20
    assert isinstance(SlamMap.load(saved).restore(SlamPipeline), SlamPipeline)
