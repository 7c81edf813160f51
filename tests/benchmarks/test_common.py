"""The frame of the benchmarks: intervals, tables, the gate and the command line."""

import importlib
import json
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import common
from benchmarks.common import Options
from benchmarks.pages import pages
from benchmarks.tables import MOST_COLUMNS, one_table, report_of, summary
from mecp_env.core import intervals

FIGURES = {"scan": {"us": 10.0}, "steps_per_s": 2000.0, "complete": intervals.share([True] * 10), "rmse_m": 0.02}


def content(calibration: float = 5.0, **changes: object) -> dict[str, Any]:
    return {"figures": {**FIGURES, **changes}, "calibration_ms": calibration}


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
    assert intervals.ratio([9, 0], [10, 1])["value"] == pytest.approx(9 / 11)  # weighed by their size
    empty = intervals.estimate([]), intervals.estimate([float("nan")]), intervals.share([]), intervals.ratio([0], [0])
    assert [figure["value"] for figure in empty] == [None] * 4


def test_a_figure_is_a_ratio_a_share_a_sum_or_a_mean_by_its_name() -> None:
    runs = [{"tp": 9, "fp": 1, "lost": True, "far": 2, "rmse_m": 0.1}, {"tp": 1, "fp": 0, "lost": False, "far": 3}]
    runs[1]["rmse_m"] = 0.3
    found = summary(runs, ("precision", "lost", "far", "rmse_m"))
    assert found["precision"]["value"] == pytest.approx(10 / 11)
    assert (found["lost"]["value"], found["far"], found["rmse_m"]["value"]) == (0.5, 5, pytest.approx(0.2))


def test_nested_figures_are_rows_in_sections_of_their_names() -> None:
    mean = intervals.estimate([1.0, 1.0])
    of = {"paper": {"mecp": {"rmse_m": mean}, "known": {"rmse_m": mean, "lost": 2}}, "all": {"drives": 3}}
    page = report_of(of)
    assert page.startswith("| | drives |\n|---|---|\n| all | 3 |\n\n## paper (n = 2)\n\n| | rmse_m | lost |\n")
    assert "| mecp | 1 [1, 1] | - |" in page
    assert "| paper, known | 1 [1, 1] | 2 | - |" in one_table(of)
    many = {"paper": {f"figure_{k}": k for k in range(MOST_COLUMNS + 1)}}
    assert "| figure 3 | 3 |" in one_table(many)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"scan": {"us": 14.0}}, "scan/us: 14, baseline 10"),
        ({"steps_per_s": 1400.0}, "steps_per_s: 1,400, baseline 2,000"),
        ({"complete": intervals.share([False] * 10)}, "complete: 0 [0, 0.2775], baseline 1 [0.7225, 1]"),
        ({"rmse_m": 0.03}, "rmse_m"),
        ({"scan": {}}, "scan/us: missing"),
        ({"complete": intervals.share([])}, "complete: none"),
        ({"rmse_m": float("nan")}, "rmse_m: nan"),
    ],
)
def test_another_or_missing_figure_fails_the_gate(changes: dict[str, object], named: str) -> None:
    (line,) = common.differences(content(**changes), content())
    assert named in line


def test_times_are_compared_by_their_ratio_to_the_calibration() -> None:
    assert common.differences(content(), content()) == []
    assert common.differences(content(new=1.0), content(complete=intervals.share([True] * 8 + [False]))) == []
    assert common.differences(content(10.0, scan={"us": 20.0}, steps_per_s=1000.0), content()) == []
    assert len(common.differences(content(10.0, scan={"us": 27.0}, steps_per_s=700.0), content())) == 2


def cube(unit: tuple[str, int]) -> float:
    """The task of the units below; some fail."""
    if unit[1] > 4:
        raise TypeError(f"no {unit[0]} of {unit[1]}")
    return 0.1 * unit[1] ** 3


UNITS = [("cube", n) for n in range(5)]


def test_a_unit_that_fails_is_named_and_raised_when_the_others_are_finished(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(TypeError, match="no cube of 7"):
        common.in_parallel(cube, float, [("cube", 7), *UNITS], Options(folder=tmp_path))
    assert "failed: ('cube', 7): TypeError: no cube of 7 (cube, line" in capsys.readouterr().err
    assert len(list(tmp_path.iterdir())) == len(UNITS)


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., types.ModuleType]:
    """Puts a benchmark in the place of another one; results and units go to a temporary folder."""
    monkeypatch.setattr(common, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(common, "UNITS", tmp_path / "units")
    monkeypatch.setattr(common, "calibration_ms", lambda: 5.0)

    def put(name: str, run: Callable[[Options], Any]) -> types.ModuleType:
        module = types.ModuleType(f"benchmarks.{name}")
        module.run = run  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return module

    return put


def test_a_benchmark_in_units_writes_its_results_only_when_all_shards_are_there(
    toy: Callable[..., types.ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    toy("worlds", lambda options: {"sum": sum(common.in_parallel(cube, float, UNITS, options))})
    for number in (1, 2):
        assert command.main(["worlds", "--shard", f"{number}/3"]) == 0
        assert "the same command without --shard gives the figures" in capsys.readouterr().out
        assert not (tmp_path / "results").exists()
    kept = next((tmp_path / "units" / "worlds").iterdir())
    with monkeypatch.context() as patch:
        patch.setattr(common, "dependencies", lambda *_: {"checksum of the code": "other"})
        assert command.main(["worlds", "--shard", "3/3"]) == 1
    assert f"{kept.parent} has results of another run: checksum of the code" in capsys.readouterr().err
    assert command.main(["worlds"]) == 0
    written = json.loads((tmp_path / "results" / "worlds.json").read_text())
    assert written["figures"] == {"sum": sum(map(cube, UNITS))}
    assert not kept.exists()  # another run measures again


def test_the_command_writes_figures_and_page_and_gates_against_them(
    toy: Callable[..., types.ModuleType], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    speeds, results = iter([200.0, 100.0, 200.0, 200.0, 100.0, 100.0]), tmp_path / "results"
    module = toy("speed", lambda options: {"steps_per_s": next(speeds)})
    assert command.main(["speed", "--gate"]) == 1  # there is no baseline
    assert command.main(["speed", "--quick", "--json", str(tmp_path / "x.json")]) == 0
    assert not results.exists()
    assert (tmp_path / "x.md").is_file()
    assert command.main(["speed"]) == 0
    written = json.loads((results / "speed.json").read_text())
    assert written["figures"] == {"steps_per_s": 200.0}
    assert {"date", "command", "machine", "calibration_ms"} <= written.keys()
    assert "| steps_per_s | 200 |" in (results / "speed.md").read_text()
    assert command.main(["speed", "--gate"]) == 0
    assert command.main(["speed", "--gate"]) == 1
    module.faults = lambda figures: ["too slow"]  # type: ignore[attr-defined]
    assert command.main(["speed", "--quick"]) == 1
    assert capsys.readouterr().err == "failed: too slow\n"


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("", "name"),
        ("speed --jobs 0", "expected at least 1"),
        ("speed --json /dev/null/x.json", "--json: /dev/null is a file, not a folder"),
        ("speed --shard 1/2", "--shard: speed does not have it; ablation"),
        ("worlds --sets easy:1001", "a count from 1 to 1000"),
        ("features --sets easy", "--sets: features is measured whole"),
        ("speed --against nosuch", "--against nosuch: no such commit"),
        ("speed --against HEAD --gate", "--against: not with --gate"),
        ("speed --gate --quick", "--quick: not with --gate"),
        (f"loop --records {__file__}", "is a file, not a folder"),
        ("clutter --with no_such_module", "--with no_such_module"),
        ("loop --cluster 127.0.0.1:1 --jobs 2", "--jobs 2: with --cluster"),
    ],
)
def test_a_wrong_command_line_ends_with_2(line: str, named: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        command.main(line.split())
    assert ended.value.code == 2
    assert named in capsys.readouterr().err


def test_every_benchmark_has_a_row_in_the_results() -> None:
    page = (Path(__file__).parents[2] / "docs/results.md").read_text()
    for name in command.NAMES:
        assert callable(importlib.import_module(f"benchmarks.{name}").run)
        assert f"| `{name}` |" in page


def test_every_page_is_what_its_result_gives() -> None:
    """`python -m benchmarks.pages` writes them again."""
    stale = [path.stem for path, page in pages() if page != path.with_suffix(".md").read_text()]
    assert not stale
