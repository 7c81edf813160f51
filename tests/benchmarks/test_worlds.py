"""The benchmark `worlds`: one whole building, and the files kept of a failure."""

import json
import re
import shlex

import mecp_env
from benchmarks import worlds
from mecp_env.world.layout import load_layout


def test_one_building_gives_all_figures() -> None:
    visit = worlds.visit(("easy", 0))
    figures = {"easy": worlds.summarise([visit])}
    assert visit["complete"]
    assert worlds.ended(visit, False)["stuck"]
    for final, outcome in (({"lost": True}, "lost"), ({"coverage": 0.9}, "stuck"), ({"doors_found": 0}, "stuck")):
        ends = worlds.ended(visit | final, True)
        assert [name for name in ("complete", "stuck", "lost") if ends[name]] == [outcome]
    assert "| complete | 1 [" in worlds.report(figures)
    assert "## easy\n\n| | bare (1) |" in worlds.report(figures)


def test_a_failure_is_kept_so_that_it_can_be_seen_again(monkeypatch, tmp_path) -> None:
    monkeypatch.setattr(worlds, "KEPT", tmp_path / "kept things")
    monkeypatch.setattr(worlds, "MAX_STEPS", 5)
    assert worlds.visit(("easy", 1))["stuck"]
    (folder,) = (tmp_path / "kept things").iterdir()
    record = json.loads((folder / "record.json").read_text())
    assert shlex.split(record["again"])[:4] == ["mecp-env", "demo", "--layout", str(folder / "layout.json")]
    assert record["version"] == mecp_env.__version__
    assert re.fullmatch(r"([0-9a-f]{40}\+?)?", record["commit"])
    assert record["again"].endswith("--seed 1 --config.start random --config.max-steps 5")
    assert len(load_layout(folder / "layout.json").rooms) == 4
    assert (folder / "map.png").stat().st_size > 5000


def test_settings_are_presets_with_something_more_and_can_be_seen_again() -> None:
    assert set(worlds.SETTINGS) == set(worlds.SETS)
    assert worlds.flags("medium_people") == " --config.crowd.people 4"
    assert worlds.flags("easy") == ""
    assert set(worlds.QUICK) <= set(worlds.SETTINGS)
    visit = worlds.visit(("medium_people", 9))
    assert visit["association_precision"] > 0.98
    assert visit["landmarks_on_movers"] <= 5
