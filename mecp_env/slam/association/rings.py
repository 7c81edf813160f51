"""Matching a polygon of the scan with the polygons of the map (III-B.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.kernel import kernel
from mecp_env.slam.association.base import chi2_gate
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.data import Corners, FeatureState, MapView, Polygon
from mecp_env.slam.protocols import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

AMBIGUITY_GAP = 9.21  # maths.md 4.2: the second best must be this much worse


@dataclass(frozen=True, slots=True, eq=False)
class RingMatch:
    """A polygon of the scan recognised as one of the map."""

    polygon: int  # index in the scan's polygons
    known: int  # index in the map's polygons
    corners: Ints  # (v,) corners whose identity the match fixes
    ids: Ints  # (v,) their landmark ids
    nis: float


def known_rings(view: MapView, cardinality: int) -> tuple[Ints, Ints]:
    """Indices (C,) of the known polygons of that cardinality made of landmarks alone, and their ids (C,k)."""
    rings = view.rings.get(cardinality)
    if rings is None:
        return np.empty(0, np.int64), np.empty((0, cardinality), np.int64)
    whole = (view.features.state[rings.ids] == int(FeatureState.LANDMARK)).all(axis=1)
    return rings.index[whole], rings.ids[whole]


@kernel
def plausible_shifts(nis: Array, rings: Ints, gate: float) -> Ints:
    """(h,2) ring and shift for which every vertex passes its own gate.

    `nis` (k,N) of the scan polygon's vertices against landmark rows; `rings` (C,k) landmark rows, both ccw.
    """
    count, k = rings.shape
    found = np.empty((count * k, 2), np.int64)
    h = 0
    for hypothesis in range(count * k):
        c, shift = hypothesis // k, hypothesis % k
        fits = True
        for v in range(k):
            fits &= nis[v, rings[c, (v + shift) % k]] <= gate
        if fits:
            found[h, 0], found[h, 1] = c, shift
            h += 1
    return found[:h]


def match_rings(
    corners: Corners,
    polygons: tuple[Polygon, ...],
    view: MapView,
    nis: Array,
    belief: Filter,
    config: AssociationConfig,
) -> RingMatch | None:
    """The best match of the scan's polygons, in their order, or None; `nis` (n,N) of corners against landmarks."""
    for p, polygon in enumerate(polygons):
        found = _match_ring(corners, polygon, view, nis, belief, config) if len(polygon.corners) >= 4 else None
        if found is not None:
            return RingMatch(p, *found)
    return None


def _match_ring(
    corners: Corners, polygon: Polygon, view: MapView, nis: Array, belief: Filter, config: AssociationConfig
) -> tuple[int, Ints, Ints, float] | None:
    k = len(polygon.corners)
    index, rings = known_rings(view, k)
    if not len(index):
        return None
    rows = view.belief.rows(rings)
    vertex_gate = 2.0 * chi2_gate(2, config.gate_probability)  # generous: the joint test decides
    shifts = plausible_shifts(np.ascontiguousarray(nis[polygon.corners]), rows, vertex_gate)
    z, R = corners.measurements(polygon.corners)
    hypotheses = []
    for c, shift in shifts:
        ids = np.concatenate((rings[c, shift:], rings[c, :shift]))
        if belief.mean_of_gaussians_nis(z, R, ids, paper_S=config.paper_S) > chi2_gate(2, config.gate_probability):
            continue
        joint = belief.joint_nis(z, R, ids)
        if joint <= chi2_gate(2 * k, config.gate_probability):
            hypotheses.append((joint, int(index[c]), ids))
    return _agreed(hypotheses, polygon.corners)


def _agreed(hypotheses: list[tuple[float, int, Ints]], corners: Ints) -> tuple[int, Ints, Ints, float] | None:
    """The best hypothesis, cut down to the vertices on which all serious rivals agree; None under three of them."""
    if not hypotheses:
        return None
    nis, known, ids = min(hypotheses, key=lambda h: (h[0], h[1]))
    agreed = np.ones(len(ids), np.bool_)
    for rival in hypotheses:
        if rival[0] < nis + AMBIGUITY_GAP:
            agreed &= rival[2] == ids
    if agreed.sum() < 3:
        return None
    return known, corners[agreed], ids[agreed], nis
