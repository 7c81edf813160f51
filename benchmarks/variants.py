"""Variants of the estimator that are compared on the same data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mecp_env.config import merge
from mecp_env.slam.association import MecpAssociator, make_associator
from mecp_env.slam.association.gating import PairingTable
from mecp_env.slam.config import METHODS, AssociationConfig, SlamConfig
from mecp_env.slam.messages import Corners, MapView, Polygon
from mecp_env.slam.protocols import Associator, Filter


class OnePassAssociator(MecpAssociator):
    """`mecp` without its first pass: polygons and corners are paired at the prediction, however wide that is.

    `sharp_sigma_m` and `sharp_sigma_deg` at their upper bounds would leave out the choice among several seeds, too.
    """

    __slots__ = ()

    def _corrected(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter, table: PairingTable
    ) -> Filter:
        """The filter as it is."""
        return belief


@dataclass(frozen=True, slots=True)
class Variant:
    """What differs from the estimator of a drive."""

    change: dict[str, Any] = field(default_factory=dict)  # fields of sections of the configuration
    make: Callable[[AssociationConfig], Associator] = make_associator


def associators() -> dict[str, dict[str, Any]]:
    """What to change in an estimator for each associator that is registered now, by its name."""
    own = {
        "mecp_paper": {"association": SlamConfig.paper().association.model_dump()},
        "known": {"association": {"method": "known"}, "tracks": {"merge_m": 0.0}},
    }
    names = (*METHODS.ours, *METHODS.others)
    return {name: own.get(name, {"association": {"method": name}}) for name in names}


def with_change(slam: SlamConfig, change: dict[str, Any]) -> SlamConfig:
    """An estimator with other fields in some sections; all else is the same."""
    return SlamConfig(**merge(slam.model_dump(), change))


DEFAULT = "mecp"
WITHOUT_POLYGONS = Variant({"association": {"use_polygons": False}})
ONE_PASS = Variant(make=OnePassAssociator)
