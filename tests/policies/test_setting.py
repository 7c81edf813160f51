"""`mecp-env evaluate` in real floor plans, in one building, and in a changed environment."""

import json
import shutil
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from mecp_env.cli import main as cli
from mecp_env.core.errors import ConfigError
from mecp_env.policies.evaluation import Evaluation
from mecp_env.policies.explorers import Gain, Nearest
from mecp_env.policies.recording import Recording
from mecp_env.policies.rollout import EpisodeTask, make_rooms, run_episode
from mecp_env.policies.setting import Setting, checksum_of, plan_fields, plan_names, words_of
from mecp_env.world.layout import LIBRARY
from tests.policies.scenes import FlatDriver

NAMES = ("office", "paper", "two_rooms")


@pytest.fixture
def plans(tmp_path: Path) -> Path:
    """A folder of three plans."""
    folder = tmp_path / "plans"
    folder.mkdir()
    for name in NAMES:
        shutil.copy(LIBRARY / f"{name}.json", folder)
    return folder


def evaluate(tmp_path: Path, *words: Any, out: str = "out") -> int:
    """The exit code of a short evaluation without ground-truth poses."""
    line = ["nearest", "--no-truth", "--episodes", "4", "--max-steps", "12", "--out", tmp_path / out, *words]
    return cli.main(["evaluate", *map(str, line)])


def result_of(tmp_path: Path, out: str = "out") -> dict[str, Any]:
    """The file of results."""
    return dict(json.loads((tmp_path / out / "results.json").read_text()))


def config_of(setting: Setting) -> Any:
    """The configuration of the environment of a setting."""
    env = make_rooms(setting, Gain())
    env.close()
    return env.get_wrapper_attr("config")


def test_episode_i_is_in_plan_i_mod_n_from_the_start_i(plans: Path) -> None:
    setting = Setting(max_steps=12, **plan_fields(plans, {}))
    episodes = [run_episode(EpisodeTask("nearest", i, setting)) for i in range(5)]
    areas = [episode.figures["free_area_m2"] for episode in episodes]
    assert areas[:2] == areas[3:]
    assert len(set(areas)) == 3
    assert episodes[0].curve.coverage[0] != episodes[3].curve.coverage[0]
    alone = Setting(max_steps=12, **plan_fields(plans / "two_rooms.json", {}))
    assert run_episode(EpisodeTask("nearest", 2, alone)).figures == episodes[2].figures


def test_the_result_names_plans_and_changes(plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert words_of({"laser": {"max_range_m": 4.0}, "start": "layout"}) == ["laser.max_range_m 4.0", "start layout"]
    words = ("--plans", plans, "--env.laser.max_range_m", "4", "--env.odometry.scale=3", "--env.crowd.people", "2")
    assert evaluate(tmp_path, *words) == 0
    result, page = result_of(tmp_path), capsys.readouterr().out
    changes = {"laser": {"max_range_m": 4.0}, "odometry": {"scale": 3.0}, "crowd": {"people": 2}}
    assert result["setting"]["env"] == changes
    assert result["setting"]["layout"] == {"plan": {"path": str(plans)}}
    assert result["plans"] == [f"{name}.json" for name in NAMES]
    assert result["buildings"] == 4
    assert f"4 episodes in 3 buildings: {plans}, laser.max_range_m 4.0, odometry.scale 3.0" in page
    assert {name: result["setting"][name] for name in ("difficulty", "split")} == {"difficulty": "", "split": ""}


def test_episodes_of_another_setting_are_never_mixed_in(plans: Path, tmp_path: Path) -> None:
    def key(reading: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
        return Setting(**plan_fields(plans, reading or {}), **changes).run_key()

    first, laser, crowd = key(), {"laser": {"max_range_m": 4.0}}, {"crowd": {"people": 1}}
    others = [key(env=laser), key(env=crowd), key({"straighten": False}), key(task="ActiveHalls-v0"), key(max_steps=12)]
    assert all(found not in [*others[:k], first] for k, found in enumerate(others))
    assert key(estimator="truth") == first
    plans = plans.rename(tmp_path / "moved")  # the same files elsewhere
    assert key() == first
    with (plans / "paper.json").open("a") as file:
        file.write("\n")
    assert key() != first


def test_one_building_by_name_or_file(tmp_path: Path) -> None:
    assert evaluate(tmp_path, "--layout", "two_rooms", out="name") == 0
    assert evaluate(tmp_path, "--layout", LIBRARY / "two_rooms.json", out="file") == 0
    name, file = result_of(tmp_path, "name"), result_of(tmp_path, "file")
    assert name["rows"] == file["rows"]
    assert (name["setting"]["layout"], name["setting"]["content"], name["plans"]) == ("two_rooms", "two_rooms", [])
    assert file["plans"] == ["two_rooms.json"]
    episodes = (tmp_path / "name" / "episodes.csv").read_text().splitlines()[1:]
    assert len({line.split(",", 3)[3] for line in episodes}) == 4


def test_a_task_gives_its_robot_to_plans_below_what_policies_and_options_say(plans: Path) -> None:
    changes = {"laser": {"beams": 360}, "planning": {"known_ground": {"wait_steps": 7}}}
    setting = Setting("", "", "known", 90, "ActiveHalls-v0", env=changes, **plan_fields(plans, {}))
    config = config_of(setting)
    assert (config.laser.max_range_m, config.laser.beams) == (2.5, 360)
    assert (config.odometry.preset, config.observation.uncertainty) == ("skid_steer", True)
    assert (config.planning.known_ground.places, config.planning.known_ground.wait_steps) == (8, 7)
    assert (config.estimator, config.max_steps, config.start, config.actions) == ("known", 90, "random", "goal")
    assert setting.where.startswith(f"{plans}, robot of ActiveHalls-v0, laser.beams 360")


def test_a_changed_task_keeps_its_buildings_and_the_default_has_the_fields_of_older_versions() -> None:
    changed = Setting("", "validation", max_steps=20, task="ActiveHalls-v0", env={"odometry": {"scale": 4.0}})
    config = config_of(changed)
    assert (config.odometry.scale, config.odometry.slip_share) == (4.0, 0.01)
    assert config.layout["generate"]["rooms"] == 6
    old = {"difficulty": "medium", "split": "test", "estimator": "slam", "max_steps": 3000, "task": ""}
    assert Setting().named() == old
    assert Setting().run_key() == {name: value for name, value in old.items() if name != "estimator"}


def test_names_and_content_of_plans(plans: Path) -> None:
    fields = plan_fields(plans, {})
    setting = Setting(**fields)
    assert plan_names(setting) == [f"{name}.json" for name in NAMES]
    assert plan_names(Setting(**plan_fields(plans / "paper.json", {}))) == ["paper.json"]
    files = tuple(sorted(plans.iterdir()))
    assert checksum_of(files, plans) == fields["content"] != checksum_of(files[:2], plans)
    (plans / "paper.json").rename(plans / "paper2.json")
    assert plan_fields(plans, {})["content"] != fields["content"]
    with pytest.raises(ConfigError, match=r"plans: .*: files have changed since the evaluation started"):
        setting.buildings(0)
    sheet, found = plans / "a.yaml", set()  # the image of a plan is a part of its content
    sheet.write_text("image: a.png\nresolution: 0.05\norigin: [0.0, 0.0, 0.0]\n")
    for data in (b"1", b"2"):
        (plans / "a.png").write_bytes(data)
        found.add(checksum_of((sheet,), plans))
    assert len(found) == 2


def test_an_unreadable_plan_fails_by_name_and_the_others_go_on(
    plans: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (plans / "paper.json").write_text('{"name": 3, "rooms": []}')
    assert evaluate(tmp_path, "--plans", plans) == 1
    said = capsys.readouterr()
    assert "paper.json" in said.err
    assert "3 episodes in 3 buildings" in said.out
    (plans / "office.json").write_text('{"name": 3, "rooms": []}')  # the first one
    evaluation = Evaluation(("nearest",), Setting(**plan_fields(plans, {})), 1)
    with pytest.raises(ValueError, match=r"office\.json"):
        evaluation.unrepeatable([Nearest()])


class MapReader(FlatDriver):
    """The same with the tables and the coarse map."""

    settings = MappingProxyType({"observation": {"map": True}})

    def act(self, observation: Any, mask: Any = None) -> int:
        """Ahead."""
        return int(observation["map"].shape == (8, 64, 64))


@pytest.mark.parametrize("policy", [FlatDriver(), MapReader()])
@pytest.mark.parametrize("observation", ["dict", "flat"])
def test_a_recorded_policy_sees_the_format_that_it_needs_whatever_is_recorded(policy: Any, observation: str) -> None:
    setting = Setting("easy", "validation", "slam", 3)
    rows = next(iter(Recording(policy, setting, observation).episodes(0, 1)))
    assert rows.actions == [1, 1, 1]
    assert isinstance(rows.observations[0], dict) == (observation == "dict")


def test_the_format_does_not_change_where_a_policy_drives() -> None:
    """The number of a goal may differ, as the rows of a format are in an order of its own."""
    setting = Setting("easy", "validation", "slam", 40)
    formats = (next(iter(Recording(Gain(), setting, name).episodes(0, 1))) for name in ("flat", "dict", "image"))
    flat, tables, image = ([(info["metres"], info["coverage"]) for info in rows.infos] for rows in formats)
    assert flat == tables == image
