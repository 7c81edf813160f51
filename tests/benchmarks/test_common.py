"""The frame of the benchmarks: intervals, tables, the gate and the command line."""

from __future__ import annotations

import importlib
import json
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import common
from benchmarks.common import Gate, Options
from mecp_env.core import intervals
from mecp_env.core.work_units import Shard

GATES = (
    Gate("scan/us", "time", 1.3),
    Gate("steps_per_s", "rate_per_s", 1.3),
    Gate("complete", "share", 0.05),
    Gate("rmse_m", "error", 1.2),
    Gate("crowd", "bound", 2.0),
)
FIGURES = {
    "scan": {"us": 10.0},
    "steps_per_s": 2000.0,
    "complete": intervals.share([True] * 10),
    "rmse_m": 0.02,
    "crowd": 1.2,
}


def content(calibration: float = 5.0, **changes: object) -> dict[str, object]:
    return {"figures": {**FIGURES, **changes}, "calibration_ms": calibration}


@pytest.mark.parametrize("name", command.NAMES)
def test_every_benchmark_has_figures_and_gates_and_a_row_in_the_results(name: str) -> None:
    module = importlib.import_module(f"benchmarks.{name}")
    assert callable(module.run)
    assert module.GATES
    assert f"| `{name}` |" in (Path(__file__).parents[2] / "docs/results.md").read_text()


def test_the_interval_of_a_mean_covers_it_about_95_times_in_100() -> None:
    rng = np.random.default_rng(1)
    runs = [intervals.estimate(rng.normal(3.0, 2.0, 40)) for _ in range(200)]
    covered = np.mean([run["low"] <= 3.0 <= run["high"] for run in runs])
    assert 0.89 <= covered <= 0.98


def test_the_interval_of_a_share_has_a_width_when_all_succeed() -> None:
    all_of_ten = intervals.share([True] * 10)
    assert all_of_ten["value"] == 1.0
    assert all_of_ten["high"] == pytest.approx(1.0)
    assert 0.65 < all_of_ten["low"] < 0.8


def test_a_ratio_weighs_runs_by_their_size() -> None:
    assert intervals.ratio([9, 0], [10, 1])["value"] == pytest.approx(9 / 11)


def test_an_empty_sample_gives_no_figure() -> None:
    assert intervals.estimate([])["value"] is None
    assert intervals.estimate([float("nan")])["value"] is None
    assert intervals.share([])["value"] is None
    assert intervals.ratio([0], [0])["value"] is None


def test_the_same_figures_pass_the_gate() -> None:
    assert common.failures(GATES, content(), content()) == []


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"scan": {"us": 14.0}}, "scan/us"),
        ({"steps_per_s": 1400.0}, "steps_per_s"),
        ({"complete": intervals.share([False] * 10)}, "complete"),
        ({"rmse_m": 0.03}, "rmse_m"),
        ({"crowd": 2.1}, "crowd"),
        ({"scan": {}}, "missing in this run"),
        ({"complete": intervals.share([])}, "missing in this run"),
        ({"rmse_m": float("nan")}, "missing in this run"),
    ],
)
def test_a_worse_or_missing_figure_fails_the_gate(changes: dict[str, object], named: str) -> None:
    (line,) = common.failures(GATES, content(**changes), content())
    assert named in line


def test_a_bound_holds_whatever_the_baseline_was() -> None:
    assert common.failures(GATES, content(crowd=1.9), content(crowd=1.0)) == []
    assert common.failures(GATES, content(crowd=2.1), content(crowd=3.0))


def test_a_figure_that_the_baseline_misses_fails_the_gate() -> None:
    (line,) = common.failures(GATES, content(), content(scan={}))
    assert "missing in the baseline" in line


def test_times_are_compared_by_their_ratio_to_the_calibration() -> None:
    slow_machine = content(10.0, scan={"us": 20.0}, steps_per_s=1000.0)
    assert common.failures(GATES, slow_machine, content()) == []
    worse = common.failures(GATES, content(10.0, scan={"us": 27.0}, steps_per_s=700.0), content())
    assert len(worse) == 2


def cube(unit: tuple[str, int]) -> float:
    """The task of the units below; some fail."""
    if unit[1] > 4:
        raise TypeError(f"no {unit[0]} of {unit[1]}")
    return 0.1 * unit[1] ** 3


UNITS = [("cube", n) for n in range(5)]


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_units_give_the_same_results_in_order(jobs: int, tmp_path: Path) -> None:
    options = Options(jobs=jobs, folder=tmp_path)
    assert common.in_parallel(cube, float, UNITS, options) == [cube(unit) for unit in UNITS]


def test_a_unit_that_fails_is_named_and_raised_when_the_others_are_finished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(TypeError, match="no cube of 7"):
        common.in_parallel(cube, float, [("cube", 7), *UNITS], Options(folder=tmp_path))
    assert "failed: ('cube', 7): TypeError: no cube of 7 (cube, line" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == len(UNITS)


def test_a_run_continues_and_shards_add_up_to_it(tmp_path: Path) -> None:
    for number in (1, 2):
        with pytest.raises(common.ShardDone, match=f"{4 - number} units of shard {number}/2 are in"):
            common.in_parallel(cube, float, UNITS, Options(folder=tmp_path, shard=Shard(number, 2)))
    results = common.in_parallel(lambda unit: None, float, UNITS, Options(folder=tmp_path))  # all are there
    assert results == [cube(unit) for unit in UNITS]


def test_progress_counts_what_is_left_of_this_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common.in_parallel(cube, float, UNITS[:2], Options(folder=tmp_path))
    assert capsys.readouterr().err == "1 of 2 units, 0.0 min left\n2 of 2 units, 0.0 min left\n"
    common.in_parallel(cube, float, UNITS, Options(folder=tmp_path))
    assert [line.partition(",")[0] for line in capsys.readouterr().err.splitlines()] == [
        f"{n} of 3 units" for n in (1, 2, 3)
    ]


def test_results_are_grouped_by_all_but_the_number_of_their_unit() -> None:
    units = [("a", 0), ("a", 1), ("b", 0)]
    assert common.grouped(units, [5, 6, 7]) == {"a": [5, 6], "b": [7]}
    assert common.grouped([("a", "x", 0), ("a", "y", 0)], [5, 6]) == {("a", "x"): [5], ("a", "y"): [6]}


@pytest.mark.parametrize("name", command.IN_UNITS)
def test_a_benchmark_in_units_writes_its_results_only_when_all_shards_are_there(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    module = types.ModuleType(f"benchmarks.{name}")
    module.run = lambda options: {"sum": sum(common.in_parallel(cube, float, UNITS, options))}  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(command, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(command, "UNITS", tmp_path / "units")
    monkeypatch.setattr(command, "calibration_ms", lambda: 5.0)
    for number in (1, 2, 3):
        assert command.main([name, "--shard", f"{number}/3"]) == 0
        assert "the same command without --shard gives the figures" in capsys.readouterr().out
        assert not (tmp_path / "results").exists()
    kept = next((tmp_path / "units" / name).iterdir())
    assert command.main([name]) == 0
    assert json.loads((tmp_path / "results" / f"{name}.json").read_text())["figures"] == {"sum": sum(map(cube, UNITS))}
    assert not kept.exists()  # another run measures again


def test_units_of_other_code_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    module = types.ModuleType("benchmarks.worlds")
    module.run = lambda options: common.in_parallel(cube, float, UNITS, options)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(command, "UNITS", tmp_path)
    monkeypatch.setattr(command, "calibration_ms", lambda: 5.0)
    assert command.main(["worlds", "--shard", "1/2"]) == 0
    monkeypatch.setattr(common, "dependencies", lambda *_: {"checksum of the code": "other"})
    assert command.main(["worlds", "--shard", "2/2"]) == 1
    assert f"{tmp_path / 'worlds'} has results of another run: checksum of the code" in capsys.readouterr().err


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> types.ModuleType:
    module = types.ModuleType("benchmarks.speed")
    module.run = lambda options: {"steps_per_s": 100.0 if options.quick else 200.0}  # type: ignore[attr-defined]
    module.GATES = (Gate("steps_per_s", "rate_per_s", 1.3),)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "benchmarks.speed", module)
    monkeypatch.setattr(command, "RESULTS", tmp_path)
    monkeypatch.setattr(command, "UNITS", tmp_path / "units")
    monkeypatch.setattr(command, "calibration_ms", lambda: 5.0)
    return module


def test_the_command_writes_figures_and_page_and_gates_against_them(toy: types.ModuleType, tmp_path: Path) -> None:
    assert command.main(["speed"]) == 0
    written = json.loads((tmp_path / "speed.json").read_text())
    assert written["figures"] == {"steps_per_s": 200.0}
    assert {"date", "command", "machine", "calibration_ms"} <= written.keys()
    assert "| steps_per_s | 200 |" in (tmp_path / "speed.md").read_text()
    assert command.main(["speed", "--gate"]) == 0
    assert command.main(["speed", "--gate", "--quick"]) == 1


def test_a_quick_run_writes_only_where_it_is_told(toy: types.ModuleType, tmp_path: Path) -> None:
    assert command.main(["speed", "--quick"]) == 0
    assert not list(tmp_path.iterdir())
    assert command.main(["speed", "--quick", "--json", str(tmp_path / "x.json")]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["x.json", "x.md"]


def test_a_gate_without_a_baseline_fails(toy: types.ModuleType) -> None:
    assert command.main(["speed", "--gate"]) == 1


@pytest.mark.parametrize(
    "line",
    [
        ["unknown"],
        ["speed", "--jobs", "0"],
        ["speed", "--jobs", "x"],
        [],
        ["worlds", "--shard", "3/2"],
        ["speed", "--shard", "1/2"],
    ],
)
def test_a_wrong_command_line_ends_with_2(line: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.main(line)
    assert ended.value.code == 2


def test_options_are_what_benchmarks_are_given() -> None:
    assert Options() == Options(jobs=1, quick=False)


@pytest.mark.parametrize("name", command.NAMES)
def test_every_gate_finds_its_figure_in_the_committed_results(name: str) -> None:
    """A gate with a misspelt path would fail every run: a baseline compared with itself must pass."""
    baseline = common.RESULTS / f"{name}.json"
    if not baseline.is_file():
        pytest.skip(f"no committed results of {name}")
    content = json.loads(baseline.read_text())
    assert common.failures(importlib.import_module(f"benchmarks.{name}").GATES, content, content) == []
