"""Variants of the estimator that are compared on the same data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from benchmarks.clipper import ClipperAssociator
from benchmarks.kiss import KissAssociator, KissPointsAssociator
from mecp_env.config import merge
from mecp_env.core.carriers import Array
from mecp_env.slam.association import MecpAssociator, make_associator
from mecp_env.slam.association.cliques import FirstPass
from mecp_env.slam.association.gating import MatchBuilder
from mecp_env.slam.association.mecp import PolygonMatch
from mecp_env.slam.association.rivals import pair_jointly
from mecp_env.slam.config import KINDS, METHODS, AssociationConfig, SlamConfig
from mecp_env.slam.messages import Belief, Corners, MapView, Polygon
from mecp_env.slam.protocols import Associator, Filter


class OnePassAssociator(MecpAssociator):
    """`mecp` without its first pass: polygons and corners are paired at the prediction, however wide that is."""

    __slots__ = ()

    def _in_two_passes(
        self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter
    ) -> MatchBuilder:
        """The decisions at the prediction."""
        return self._paired(corners, polygons, view, belief)


class PolygonsAlone(FirstPass):
    """Only a polygon proposes a pose."""

    __slots__ = ()

    def propose_cliques(self, costs: Array) -> None:
        """None."""


class PolygonAssociator(MecpAssociator):
    """`mecp` whose first pass has no cliques: without a polygon that is recognised, nothing is paired."""

    __slots__ = ()

    def _first_pass(self) -> type[FirstPass]:
        """One without cliques."""
        return PolygonsAlone


class TwoPassJcbbAssociator(MecpAssociator):
    """`mecp` with the search of `jcbb` in its second pass, among the pairs that a recognised polygon leaves."""

    __slots__ = ()

    def _pair(
        self,
        builder: MatchBuilder,
        corners: Corners,
        costs: Array,
        found: PolygonMatch | None,
        predicted: Belief,
        belief: Filter,
    ) -> None:
        """Enter the hypothesis of JCBB; the corners of a polygon have no other choice."""
        if found is not None:
            builder.polygon, builder.map_polygon = found.polygon, found.map_polygon
            costs[found.corners] = math.inf
            costs[found.corners, predicted.rows(found.ids)] = 0.0
        pair_jointly(builder, corners, costs, predicted.ids, belief, self.config)


@dataclass(frozen=True, slots=True)
class Variant:
    """What differs from the estimator of a drive."""

    change: dict[str, Any] = field(default_factory=dict)  # fields of sections of the configuration
    make: Callable[[AssociationConfig], Associator] = make_associator


def with_change(slam: SlamConfig, change: dict[str, Any]) -> SlamConfig:
    """An estimator with other fields in some sections; all else is the same."""
    return SlamConfig(**merge(slam.model_dump(), change))


DEFAULT = "mecp"
WITHOUT_POLYGONS = Variant({"association": {"use_polygons": False}})
ONE_PASS = Variant(make=OnePassAssociator)
POLYGONS_ALONE = Variant(make=PolygonAssociator)
CLIPPER = Variant({"association": {"use_rooms": False}}, ClipperAssociator)
KISS = {  # where the package is installed
    "kiss-matcher with descriptor": Variant(CLIPPER.change, KissAssociator),
    "kiss-matcher on points": Variant(CLIPPER.change, KissPointsAssociator),
}

RIVALS: dict[str, dict[str, Any]] = {  # fields of the association section; none uses polygons
    "jcbb": {"method": "jcbb", "use_rooms": False, "use_descriptor": False},
    "jcbb with descriptor": {"method": "jcbb", "use_rooms": False},
    "jcbb with descriptor and rooms": {"method": "jcbb"},
    "ccda": {"method": "ccda", "use_rooms": False, "use_descriptor": False},
    "ccda with descriptor": {"method": "ccda", "use_rooms": False},
    "joint_descriptor": {"method": "joint_descriptor", "use_rooms": False},
    "nearest_room": {"method": "nearest_room"},
    "nearest_descriptor": {"method": "nearest_descriptor"},
}


def own_rows() -> dict[str, dict[str, Any]]:
    """What to change in an estimator for each part that modules have registered: an associator, or `mecp`'s filter."""
    rows: dict[str, dict[str, Any]] = {name: {"association": {"method": name}} for name in METHODS.others}
    return rows | {f"{DEFAULT}, filter {name}": {"filter": {"kind": name}} for name in KINDS.others}


def associators() -> dict[str, dict[str, Any]]:
    """What to change in an estimator for each associator that is registered now: one row or several of each."""
    rows: dict[str, dict[str, Any]] = {
        "mecp_paper": {"association": SlamConfig.paper().association.model_dump()},
        "known": {"association": {"method": "known"}, "tracks": {"merge": False}},
    }
    rows |= {name: {"association": fields} for name, fields in RIVALS.items()}
    names = (*METHODS.ours, *METHODS.others)
    rows = {name: {"association": {"method": name}} for name in names} | rows
    method = {name: change["association"]["method"] for name, change in rows.items()}
    return {name: rows[name] for known in names for name in rows if method[name] == known}


def rival(name: str) -> Variant:
    """One of the RIVALS as it is."""
    return Variant({"association": RIVALS[name]})


def two_pass_jcbb(use_polygons: bool) -> Variant:
    """JCBB with descriptor in the two passes of `mecp`, with its polygons or without."""
    return Variant({"association": {"use_polygons": use_polygons, "use_rooms": False}}, TwoPassJcbbAssociator)
