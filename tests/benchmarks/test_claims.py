"""The benchmark `claims`: what holds is what the interval says, and the pieces of its experiments."""

import json
from itertools import islice

import numpy as np

from benchmarks import claims, tables
from benchmarks.claim_units import lines_of_sight, recalls
from benchmarks.common import RESULTS
from benchmarks.records import Course
from mecp_env.slam.pipeline import SlamPipeline


def test_a_claim_holds_where_its_whole_interval_says_so() -> None:
    for low, high, below, above in ((0.1, 0.4, "yes", "no"), (0.6, 0.7, "no", "yes"), (0.4, 0.6, "open", "open")):
        figures = {"part": {"figure": {"value": 0.5 * (low + high), "low": low, "high": high, "n": 3}}}
        for bound, said in (("at_most", below), ("at_least", above)):
            claim = claims.Claim("I", "sentence", "experiment", "part/figure", **{bound: 0.5})
            assert claim.holds(figures) == said
    for missing in ({}, {"part": {"figure": None}}, {"part": {"figure": dict.fromkeys(("value", "low", "high"))}}):
        assert claim.holds(missing) == "open"
    assert "**open**" in claims.report({})
    found = recalls([[1, 2], [0, 0]])
    assert found[0] == 0.5
    assert np.isnan(found[1])  # of a pose without a visible corner


def test_every_claim_names_figures_of_the_committed_results() -> None:
    figures = json.loads((RESULTS / "claims.json").read_text())["figures"]
    flat = tables.flatten(figures)
    assert {name for claim in claims.CLAIMS for name in (claim.figure, *claim.beside)} <= flat.keys()
    page = claims.report(figures)
    for claim in claims.CLAIMS:
        assert f'"{claim.sentence}" ({claim.section})' in page
        assert claim.holds(figures) in ("yes", "no", "open")


def test_lines_to_the_vertices_are_free_in_a_bare_room() -> None:
    drive, rng = Course("two_rooms", 0).drive(), np.random.default_rng(0)
    for output, T_world_robot in islice(drive.outputs(SlamPipeline(drive.slam)), 8):
        seen = lines_of_sight(drive, output, output.polygons, T_world_robot, rng)
        assert len(seen) >= 4 * 4
        assert seen.mean() > 0.9
        assert not len(lines_of_sight(drive, output, (), T_world_robot, rng))
