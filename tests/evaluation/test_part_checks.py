"""The checks of custom parts: ours pass, and each kind of mistake is named with its method."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mecp_env.core.errors import ConfigError
from mecp_env.evaluation.part_checks import check_associator, check_filter
from mecp_env.slam import MatchError
from mecp_env.slam.association import make_associator
from mecp_env.slam.config import KINDS, METHODS
from mecp_env.slam.filters import Ekf, FilterError, make_filter
from mecp_env.slam.messages import Decision


@pytest.mark.parametrize("kind", sorted(KINDS.ours))
def test_our_filters_pass(kind: str) -> None:
    check_filter(lambda config: make_filter(config.model_copy(update={"kind": kind})))


@pytest.mark.parametrize("method", sorted(set(METHODS.ours) - {"known"}))
def test_our_associators_pass(method: str) -> None:
    assert check_associator(lambda config: make_associator(config.model_copy(update={"method": method}))) > 30


WRONG: list[tuple[str, Any, str]] = [
    ("update", lambda *_, **__: None, "update"),  # nothing is learnt
    ("copy", lambda self: self, "copy"),
    ("individual_nis", lambda self, *given: 2.0 * Ekf.individual_nis(self, *given) + 1.0, "individual_nis"),
    ("belief", lambda self: replace(Ekf.belief(self), pose_cov=-Ekf.belief(self).pose_cov), "predict"),
    ("belief", lambda self: replace(Ekf.belief(self), ids=self.ids[::-1].copy()), "belief"),
]


@pytest.mark.parametrize(("method", "wrong", "named"), WRONG)
def test_what_is_wrong_with_a_filter_is_named(method: str, wrong: Any, named: str) -> None:
    with pytest.raises(FilterError, match=f"^{named}: "):
        check_filter(type("Mine", (Ekf,), {method: wrong}))


def spoilt(config: Any, spoil: Any) -> Any:
    """The default associator, whose matches are spoilt."""
    own = make_associator(config)
    associate = own.associate
    own.associate = lambda corners, polygons, view, belief: spoil(
        associate(corners, polygons, view, belief), view, belief
    )
    return own


def twice(match: Any, view: Any, belief: Any) -> Any:
    found = match.recognised()
    return match.assign(found[:2], match.ids[found[0]], int(Decision.LANDMARK), 0) if len(found) > 1 else match


def unknown(match: Any, view: Any, belief: Any) -> Any:
    return match.assign(0, 10_000, int(Decision.LANDMARK), 0)


def moving(match: Any, view: Any, belief: Any) -> Any:
    belief.set_pose(np.array([0.1, 0.0, 0.0]))
    return match


def farther(match: Any, view: Any, belief: Any) -> Any:
    view.belief.p_map[:] += 1.0
    return match


def drawn(match: Any, view: Any, belief: Any, rng: Any = np.random.default_rng(0)) -> Any:  # noqa: B008
    found = match.recognised()
    return match.assign(found[rng.random(len(found)) < 0.5], -1, int(Decision.IGNORED), 0)


SAID = [(twice, "at most once"), (unknown, "10000"), (moving, "changes the filter"), (farther, "that it is given")]


@pytest.mark.parametrize(("spoil", "said"), [*SAID, (drawn, "same scan")])
def test_what_is_wrong_with_an_associator_is_named(spoil: Any, said: str) -> None:
    with pytest.raises(MatchError, match=said):
        check_associator(lambda config: spoilt(config, spoil))


@pytest.mark.parametrize(("check", "kind"), [(check_filter, "Filter"), (check_associator, "Associator")])
def test_what_a_part_lacks_is_named(check: Any, kind: str) -> None:
    with pytest.raises(ConfigError, match=rf"SimpleNamespace has no .*; derive from mecp_env\.slam\.protocols\.{kind}"):
        check(lambda config: SimpleNamespace())
