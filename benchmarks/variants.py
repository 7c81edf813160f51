"""Variants of the estimator that are compared on the same data."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.clipper import ClipperAssociator
from benchmarks.drives import Drive, Replay, replay
from benchmarks.kiss import KissAssociator, KissPointsAssociator
from mecp_env.config import merge
from mecp_env.core.carriers import Array
from mecp_env.core.errors import MecpError
from mecp_env.lab.rivals import pair_jointly
from mecp_env.slam.association import MecpAssociator, make_associator
from mecp_env.slam.association.cliques import FirstPass
from mecp_env.slam.association.gating import MatchBuilder
from mecp_env.slam.association.mecp import PolygonMatch
from mecp_env.slam.config import KINDS, METHODS, AssociationConfig, SlamConfig
from mecp_env.slam.messages import Belief, Corners
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.protocols import Associator, Filter


class OnePassAssociator(MecpAssociator):
    """`mecp` without its first pass: polygons and corners are paired at the prediction, however wide that is."""

    __slots__ = ()

    def _in_two_passes(self, *scan_and_map: Any) -> MatchBuilder:
        """The decisions at the prediction."""
        return self._paired(*scan_and_map)


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


def with_change(slam: SlamConfig, change: dict[str, Any]) -> SlamConfig:
    """An estimator with other fields in some sections; all else is the same."""
    return SlamConfig(**merge(slam.model_dump(), change))


@dataclass(frozen=True, slots=True)
class Variant:
    """What differs from the estimator of a drive."""

    change: dict[str, Any] = field(default_factory=dict)  # fields of sections of the configuration
    make: Callable[[AssociationConfig], Associator] = make_associator

    def associator(self, slam: SlamConfig) -> Associator:
        """The associator in place of that of an estimator."""
        return self.make(with_change(slam, self.change).association)


def associating(**fields: Any) -> Variant:
    """Other fields in the section of association."""
    return Variant({"association": fields})


def replays(
    drive: Drive, rows: Mapping[str, Variant], estimator: Callable[..., SlamPipeline] = SlamPipeline
) -> dict[str, Replay]:
    """What the estimator of each row makes of a drive; an error of a part says which row it is."""
    found = {}
    for name, variant in rows.items():
        try:
            found[name] = replay(drive, with_change(drive.slam, variant.change), variant.make, estimator)
        except MecpError as error:
            raise type(error)(f"{name}: {error}") from error
    return found


DEFAULT, LETTER = "mecp", "SlamConfig.paper()"
WITHOUT_ROOMS = {"association": {"use_rooms": False}}
RIVALS = {  # none uses polygons
    "jcbb": associating(method="jcbb", use_rooms=False, use_descriptor=False),
    "jcbb with descriptor": associating(method="jcbb", use_rooms=False),
    "jcbb with descriptor and rooms": associating(method="jcbb"),
    "ccda": associating(method="ccda", use_rooms=False, use_descriptor=False),
    "ccda with descriptor": associating(method="ccda", use_rooms=False),
    "joint_descriptor": associating(method="joint_descriptor", use_rooms=False),
    "nearest_room": associating(method="nearest_room"),
    "nearest_descriptor": associating(method="nearest_descriptor"),
}
KISS = {  # where the package is installed
    "kiss-matcher with descriptor": Variant(WITHOUT_ROOMS, KissAssociator),
    "kiss-matcher on points": Variant(WITHOUT_ROOMS, KissPointsAssociator),
}
VARIANTS = {
    DEFAULT: Variant(),
    "mecp without descriptor": associating(use_descriptor=False),
    "mecp without polygons": associating(use_polygons=False),
    "mecp without rooms": Variant(WITHOUT_ROOMS),
    "mecp without both": associating(use_polygons=False, use_descriptor=False),  # polygons and descriptor
    "mecp without cliques": Variant(make=PolygonAssociator),
    "mecp in one pass": Variant(make=OnePassAssociator),
    "mecp_paper": associating(**SlamConfig.paper().association.model_dump()),
    "jcbb with descriptor in two passes": Variant(
        {"association": {"use_polygons": False, "use_rooms": False}}, TwoPassJcbbAssociator
    ),
    "jcbb with all of mecp": Variant(
        {"association": {"use_polygons": True, "use_rooms": False}}, TwoPassJcbbAssociator
    ),
    "clipper with descriptor": Variant(WITHOUT_ROOMS, ClipperAssociator),
    **KISS,
    **RIVALS,
    "nearest": associating(method="nearest"),
    "known": Variant({"association": {"method": "known"}, "tracks": {"merge": False}}),
    LETTER: Variant(SlamConfig.paper().model_dump()),
}


def changed(name: str, change: dict[str, Any]) -> Variant:
    """A variant with other fields, too."""
    return replace(VARIANTS[name], change=merge(VARIANTS[name].change, change))


def rows_of(*names: str) -> dict[str, Variant]:
    """Some of the variants."""
    return {name: VARIANTS[name] for name in names}


def own_rows() -> dict[str, Variant]:
    """A row for each part that modules have registered: an associator, or `mecp` with another filter."""
    rows = {name: associating(method=name) for name in METHODS.others}
    return rows | {f"{DEFAULT}, filter {name}": Variant({"filter": {"kind": name}}) for name in KINDS.others}


def associators() -> dict[str, Variant]:
    """One row or several for each associator that is registered now."""
    names = (*METHODS.ours, *METHODS.others)
    rows = {name: associating(method=name) for name in names}
    rows |= rows_of("mecp_paper", "known", *RIVALS)
    method = {name: row.change["association"]["method"] for name, row in rows.items()}
    return {name: rows[name] for known in names for name in rows if method[name] == known}
