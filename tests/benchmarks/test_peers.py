"""The comparison with other simulators: what is compared, and what happens without them."""

import importlib.util

import pytest

from benchmarks import peers
from benchmarks.in_tree import BlockDriver


def test_peers_that_are_not_installed_are_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert peers.measure(1, (1,)) == {}
    assert capsys.readouterr().err.count("is not installed (extra `peers`)") == 2
    assert "not installed" in peers.report({})


def test_our_speed_is_divided_by_that_of_the_peer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "installed", lambda: {"toy": lambda: (10, 0.01)})
    monkeypatch.setattr(peers, "BlockDriver", lambda actions, sweeps: sweeps)
    monkeypatch.setattr(peers, "our_block", lambda sweeps: (100, 0.2 * sweeps))
    figures = peers.measure(3, (1, 4))
    for sweeps, expected in (("K=1", 0.5), ("K=4", 0.125)):
        for values in figures["toy"][sweeps].values():
            assert values["ratio"]["value"] == pytest.approx(expected)
            assert values["peer_steps_per_s"] == pytest.approx(1000.0)
    assert peers.report(figures).count("| toy |") == 4
    faces = sum(len(part["shape"]["vertices"]) - 1 for part in peers.world()["obstacle"])
    assert faces == 98  # the walls of the layout


def test_our_blocks_go_on_in_a_new_episode() -> None:
    driver = BlockDriver("random", 1)
    for _ in range(2):
        steps, seconds = peers.our_block(driver)
        assert steps > 0
        assert seconds > 0.0


@pytest.mark.parametrize("kind", [peers.MiniGrid, peers.IrSim])
def test_a_block_of_a_peer_has_its_steps(kind: type[peers.MiniGrid | peers.IrSim]) -> None:
    pytest.importorskip(kind.package)
    steps, seconds = kind()()
    assert steps == kind.steps
    assert seconds > 0.0
