"""The comparison with other simulators: what is compared, and what happens without them."""

import importlib.util
from types import SimpleNamespace

import pytest

from benchmarks import peers


def test_peers_that_are_not_installed_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert peers.measure(1, (1,)) == {}
    assert capsys.readouterr().err.count("is not installed (extra `peers`)") == 2
    assert "not installed" in peers.report({})


def test_our_speed_is_divided_by_that_of_the_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    def timed(seconds: float) -> SimpleNamespace:
        return SimpleNamespace(seconds_per_step=lambda actions: seconds)

    monkeypatch.setattr(peers, "is_installed", lambda package: package == "irsim")
    monkeypatch.setattr(peers, "peer", lambda name: timed(0.001))
    monkeypatch.setattr(peers, "ours", lambda sweeps, actions: timed(0.002 * sweeps))
    figures = peers.measure(3, (1, 4))
    for sweeps, expected in (("K=1", 0.5), ("K=4", 0.125)):
        for values in figures["ir-sim"][sweeps].values():
            assert values["ratio"]["value"] == pytest.approx(expected)
            assert values["peer_steps_per_s"] == pytest.approx(1000.0)
    assert peers.report(figures).count("| ir-sim, K=") == 4
    faces = sum(len(part["shape"]["vertices"]) - 1 for part in peers.world()["obstacle"])
    assert faces == 98  # the walls of the layout


def test_our_blocks_go_on_in_a_new_episode() -> None:
    for actions in ("random", "breadth_first"):
        assert peers.ours(1, actions).seconds_per_step(3) > 0.0


@pytest.mark.parametrize("name", peers.PACKAGES)
def test_a_block_of_a_peer_is_timed(name: str) -> None:
    pytest.importorskip(peers.PACKAGES[name])
    assert peers.peer(name).seconds_per_step(20) > 0.0
