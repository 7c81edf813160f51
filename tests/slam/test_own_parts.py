"""Custom associators and filters, registered by name for every configuration (docs/own-parts.md)."""

import importlib
import math
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import PartsWarning, load_parts
from mecp_env.core.snapshot import encode
from mecp_env.evaluation.part_checks import check_associator, check_filter
from mecp_env.policies.registry import source_of
from mecp_env.slam import MatchError, SlamMap, landmark_map
from mecp_env.slam.association import MecpAssociator, register_associator
from mecp_env.slam.config import FilterConfig, SlamConfig
from mecp_env.slam.filters import Ekf, FilterError, make_filter, register_filter
from mecp_env.slam.mecp import register_structure
from mecp_env.slam.messages import Decision, FeatureState
from mecp_env.slam.pipeline import SlamPipeline
from tests.command_lines import written_modules
from tests.env.helpers import episode_of, same
from tests.slam.drives import Drive, Given, fed
from tests.slam.make import polygon

OWN = {"association": {"method": "global_nearest"}, "filter": {"kind": "plain_ekf"}, "polygon": {"structure": "both"}}


@pytest.fixture
def own(own_parts: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, ModuleType]:
    """The modules of the page, imported; their registrations are removed afterwards."""
    monkeypatch.syspath_prepend(own_parts)
    written_modules(own_parts)
    return {name: importlib.import_module(name) for name in ("global_nearest", "plain_ekf", "both")}


def test_the_parts_of_the_page_run_in_an_environment_and_its_states(own: dict[str, ModuleType]) -> None:
    env = gym.make("mecp_env/PaperMap-v0", slam=OWN).unwrapped
    env.reset(seed=1)
    for _ in range(20):
        env.step(np.array([0.5, 0.1]))
    pipeline, second = episode_of(env).pipeline, SlamPipeline(OWN)
    assert type(second.associator) is type(pipeline.associator)
    assert type(pipeline.associator) is own["global_nearest"].GlobalNearest
    assert type(pipeline.filter) is own["plain_ekf"].PlainEkf
    assert len(env.slam_output.belief.ids) > 5
    assert check_associator(own["global_nearest"].GlobalNearest) > 0
    check_filter(own["plain_ekf"].PlainEkf)
    state = env.get_state()
    other = gym.make("mecp_env/PaperMap-v0", slam=OWN).unwrapped
    other.set_state(state)
    first, second = (e.step(np.array([0.3, -0.2]))[0] for e in (env, other))
    assert all(np.array_equal(first[key], second[key]) for key in first)
    again = SlamPipeline.from_map(SlamMap.of(pipeline))
    assert type(again.associator) is type(pipeline.associator)
    assert same(encode(again.filter), encode(pipeline.filter))


def damaged(match: Any, view: Any, kind: str) -> Any:
    """A match with an error of that kind."""
    if kind == "twice":
        return match.assign(match.recognised()[:2], view.belief.ids[0], int(Decision.LANDMARK), 0)
    if kind == "track":
        track = np.flatnonzero(view.features.rows["state"] != FeatureState.LANDMARK)[0]
        return match.assign(0, track, int(Decision.LANDMARK), 0)
    if kind == "ignored":
        return replace(match, decision=np.full(len(match.ids), int(Decision.IGNORED)), ids=np.full(len(match.ids), 3))
    if kind == "writes":
        view.features.rows["seen"] += 1
        return match
    if kind == "raises":
        raise KeyError(kind)
    return replace(match, **{kind: 77})


@pytest.mark.parametrize(
    ("kind", "error", "said"),
    [
        ("twice", MatchError, "each landmark at most once"),
        ("track", MatchError, r"match.ids\[0\]: \d+ is a track, or removed"),
        ("polygon", MatchError, "Given.associate: match.polygon: 77, a number from -1"),
        ("ignored", MatchError, r"match.ids\[0\]: 3, -1 expected of a corner that is IGNORED"),
        ("writes", MatchError, "Given: it wrote to features.rows, which it was given"),
        ("raises", KeyError, "raises"),
    ],
)
def test_a_wrong_match_changes_nothing(kind: str, error: Any, said: str, drive: Drive) -> None:
    """Seen: prediction and step stayed, a landmark named twice was used twice, and `known` raised an IndexError."""
    inner, wrong = MecpAssociator(SlamConfig().association), list[str]()

    def answer(corners: Any, polygons: Any, view: Any, belief: Any) -> Any:
        match = inner.associate(corners, polygons, view, belief)
        return damaged(match, view, *wrong) if wrong else match

    pipeline = SlamPipeline(associator=Given(answer))
    list(fed(pipeline, drive, 0, 30))
    wrong.append(kind)
    assert_refused(pipeline, drive, 30, error, said)


def assert_refused(pipeline: SlamPipeline, drive: Drive, step: int, error: Any, said: str) -> None:
    """The step raises this error and changes nothing."""
    before = without_associator(pipeline)
    with pytest.raises(error, match=said):
        list(fed(pipeline, drive, step, step + 1))
    assert same(without_associator(pipeline), before)


def without_associator(pipeline: SlamPipeline) -> Any:
    """The state of a pipeline but for its associator."""
    return encode(
        {field.name: getattr(pipeline, field.name) for field in fields(pipeline) if field.name != "associator"}
    )


def spoilt(own: ModuleType, method: str, spoil: Any) -> type:
    """The filter of the page, of which one method does something else once `on` is set."""
    plain = getattr(own.PlainEkf, method)

    def changed(self: Any, *args: Any, **keywords: Any) -> Any:
        result = plain(self, *args, **keywords)
        return spoil(self, result) if Spoilt.on else result

    Spoilt = type("Spoilt", (own.PlainEkf,), {method: changed, "on": False})
    return Spoilt


def set_cov(self: Any, _: Any) -> None:
    self.cov[5, 5] = -1.0


def set_mean(self: Any, _: Any) -> None:
    self.mean[3] = np.nan


@pytest.mark.parametrize("spoil", [set_cov, set_mean])
def test_an_unsound_update_of_a_custom_filter_is_a_divergence(own, drive, spoil, caplog) -> None:
    """Seen: the run went on with a negative variance or a landmark at nan, and did not say so."""
    make = spoilt(own["plain_ekf"], "update", spoil)
    pipeline = SlamPipeline(filter=make(SlamConfig().filter))
    *_, output = fed(pipeline, drive, 0, 30)
    assert not output.diverged
    make.on = True
    output = pipeline.step(drive.odometry[30], drive.scans[30])
    assert output.diverged
    assert "Spoilt.update: " in caplog.text
    assert np.isfinite(output.belief.p_map).all()
    assert np.linalg.eigvalsh(output.belief.covs).min() > 0.0


@pytest.mark.parametrize(
    ("method", "spoil", "said"),
    [
        ("window", lambda _, found: found._replace(state=found.state[:-2, :-2]), r"window: state .* expected"),
        ("window", lambda _, found: None, "window: NoneType, a Window expected"),
        ("predict", set_mean, "Spoilt.predict: a number is not finite"),
        ("individual_nis", lambda _, found: found[:1], r"Spoilt.individual_nis: float64 \(1, \d+\); float64 \("),
        ("innovation", lambda _, found: None, "Spoilt.innovation: None; float64 "),
        ("log_bayes_factor", lambda _, found: None, "Spoilt.log_bayes_factor: None, a number expected"),
    ],
)
def test_an_unsound_custom_filter_is_refused_and_changes_nothing(own, drive, method, spoil, said) -> None:
    """Seen: compiled functions read beyond the end of a window."""
    make = spoilt(own["plain_ekf"], method, spoil)
    register_filter("spoilt", make)
    pipeline = SlamPipeline({"filter": {"kind": "spoilt"}})
    list(fed(pipeline, drive, 0, 30))
    make.on = True
    assert_refused(pipeline, drive, 30, FilterError, said)


class Flaky(MecpAssociator):
    """An associator that answers with nothing while it is off."""

    on = True

    def associate(self, *given: Any) -> Any:
        return super().associate(*given) if Flaky.on else None


@pytest.mark.usefixtures("own_parts")
def test_a_refused_step_of_an_environment_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen: the robot drove on, and the estimator was not told."""
    register_associator("flaky", Flaky)
    fields = {"slam": {"association": {"method": "flaky"}}, "crowd": {"people": 2}}
    env, other = (gym.make("mecp_env/PaperMap-v0", **fields).unwrapped for _ in range(2))
    for one in (env, other):
        one.reset(seed=1)
    before = env.get_state()
    monkeypatch.setattr(Flaky, "on", False)
    with pytest.raises(MatchError, match=r"Flaky\.associate: match: NoneType"):
        env.step(np.array([0.5, 0.1]))
    after = env.get_state()
    assert all(same(after[name], before[name]) for name in before if name != "episode")
    monkeypatch.setattr(Flaky, "on", True)
    first, second = (one.step(np.array([0.5, 0.1]))[0] for one in (env, other))
    assert all(np.array_equal(first[name], second[name]) for name in first)


def fail(self: Any, _: Any) -> None:
    raise KeyError("fails")


@pytest.mark.parametrize(("method", "spoil", "error"), [("augment", fail, KeyError), ("remove", set_mean, FilterError)])
def test_a_filter_that_fails_while_the_map_grows_changes_nothing(own, drive, method, spoil, error, monkeypatch) -> None:
    """Seen: tracks were landmarks that the filter did not have, and the next step failed as well."""
    monkeypatch.setattr(landmark_map, "find_unconfirmed", lambda _, ids, __, step: ids[: step == 25])
    make = spoilt(own["plain_ekf"], method, spoil)
    register_filter("spoilt", make)
    pipeline, whole = (SlamPipeline({"filter": {"kind": "spoilt"}}) for _ in range(2))
    failed = 0
    for k, _ in enumerate(fed(whole, drive, 0, 30)):
        make.on, before = True, without_associator(pipeline)
        with suppress(error):
            list(fed(pipeline, drive, k, k + 1))
        make.on = False
        if pipeline.step_count == k:
            failed += 1
            assert same(without_associator(pipeline), before)
            list(fed(pipeline, drive, k, k + 1))
    assert failed > 0
    assert same(without_associator(pipeline), without_associator(whole))


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (None, "gave None, a tuple of Polygon expected"),
        ((polygon([0, 1, 99]),), r"corners \[0, 1, 99\], three or more different ones of"),
        ((replace(polygon([0, 1, 2]), corners=np.zeros(3)),), "corners: an array of float64, one of int64 expected"),
        ((polygon([0, 2, 1]),), r"corners \[0, 2, 1\], counter-clockwise from the smallest expected"),
        ((polygon([0, 1, 2], np.full((1, 4), 3.0)),), r"edges \[3.0\], whole numbers from 0 to 2, ascending, expected"),
        ((polygon([0, 1, 2], np.array([[0.0, 0.0, 1.0, 9.0]])),), "shares and an EdgeLabel expected"),
        ((polygon([0, 1, 2], np.array([[0.0, math.nan, 1.0, 0.0]])),), "shares and an EdgeLabel expected"),
    ],
)
def test_a_wrong_polygon_of_a_custom_structure_changes_nothing(own_parts, drive, found, said) -> None:
    answers = list[Any]()
    register_structure("given", lambda corners, beams, config, wall: answers[0] if answers else ())
    pipeline = SlamPipeline({"polygon": {"structure": "given"}})
    list(fed(pipeline, drive, 0, 10))
    answers.append(found)
    assert_refused(pipeline, drive, 10, ConfigError, f"polygon.structure 'given'.*{said}")


def test_what_cannot_be_registered_or_is_not_is_named() -> None:
    for part in ("ekf", Ekf):
        with pytest.raises(ConfigError, match=r"filter: .*(derive from|an object of it expected)"):
            SlamPipeline(filter=part)
    with pytest.raises(ConfigError, match="make: None, a class or a function expected"):
        register_filter("nothing", None)
    for name, said in (("ekf", r"is one of ours \(riekf, riekf_submaps"), ("two words", "letters, digits and _")):
        with pytest.raises(ConfigError, match=f"name: '{name}'.*{said}"):
            register_filter(name, Ekf)
    known = r"'riekf', 'riekf_submaps', 'ekf' or 'fej'.*mean 'ekf'.*; others are registered by register_filter"
    with pytest.raises(ConfigError, match=rf"filter\.kind: .*{known}"):
        SlamConfig(filter={"kind": "ekff"})


ANNOUNCED = """
from types import SimpleNamespace

from mecp_env.episode.buildings import register_buildings
from mecp_env.episode.potentials import register_reward
from mecp_env.policies.registry import register_policy
from mecp_env.slam.association import MecpAssociator, register_associator

register_associator("announced", type("Announced", (MecpAssociator,), {}))
register_buildings("announced", lambda: SimpleNamespace(count=1, layout=lambda _: "two_rooms"))
register_policy("announced", "mecp_env.policies.explorers:Nearest")
register_reward("announced", lambda inputs: 0.0)
"""


def test_an_installed_package_announces_its_parts(own_parts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = own_parts / "announced-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: announced\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[mecp_env]\nannounced = announced_parts\n")
    monkeypatch.syspath_prepend(own_parts)
    load_parts.cache_clear()
    known, warned = (
        r"Input should be 'mecp', .* or 'known'; did you mean",
        r"announced: its entry points for mecp_env",
    )
    with pytest.warns(PartsWarning, match=warned), pytest.raises(ConfigError, match=known):
        SlamConfig.parse({"association": {"method": "nearst"}})
    assert make_filter(FilterConfig(kind="fej")).update_iterations > 1
    (own_parts / "announced_parts.py").write_text(ANNOUNCED)
    load_parts.cache_clear()
    assert type(SlamPipeline({"association": {"method": "announced"}}).associator).__name__ == "Announced"
    assert source_of("announced") == "mecp_env.policies.explorers:Nearest"
    fields = {"reward": {"custom": {"announced": 1.0}}, "layout": {"announced": {}}}
    assert gym.make("mecp_env/Layout-v0", **fields).reset(seed=0)[1]["building"] == 0
    load_parts.cache_clear()
