"""Matching a polygon of the scan with the polygons of the map (III-B.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mecp_env.core.jit import compiled
from mecp_env.slam.association.base import chi2_gate
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, FeatureState, MapView, Polygon, Rings
from mecp_env.slam.protocols import Filter

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LANDMARK = int(FeatureState.LANDMARK)
AMBIGUITY_GAP = 9.21  # 99 % of chi-square with 2: the second best must be this much worse (derivations 3.2)


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
    whole = (view.features.state[rings.ids] == LANDMARK).all(axis=1)
    return rings.index[whole], rings.ids[whole]


@compiled
def plausible_rings(
    nis: Array, corners: Ints, landmarks: Ints, state: Ints, rings: Ints, gate: float, found: Ints, which: Ints
) -> int:
    """Write the ids (h,k) of the known rings, turned so that every vertex passes its own gate, and which (h,) they are.

    `nis` (n,N) of corners against `landmarks` (N,); `corners` (k,) are the vertices of the scan's polygon, `rings`
    (C,k) ids of features with their `state` (F,), both ccw. A ring of landmarks alone counts. Returns h.
    """
    count, k = rings.shape
    row = np.empty(state.shape[0], np.int64)
    for j in range(landmarks.shape[0]):
        row[landmarks[j]] = j
    h = 0
    for c in range(count):
        for shift in range(k if _all_landmarks(rings[c], state) else 0):
            if _passes(nis, corners, row, rings[c], shift, gate):
                which[h] = c
                _turn(rings[c], shift, found[h])
                h += 1
    return h


@compiled
def _all_landmarks(ids: Ints, state: Ints) -> bool:
    whole = True
    for v in range(ids.shape[0]):
        whole &= state[ids[v]] == LANDMARK
    return whole


@compiled
def _passes(nis: Array, corners: Ints, row: Ints, ring: Ints, shift: int, gate: float) -> bool:
    """True when each of the corners (k,) is inside the gate of the landmark `shift` vertices on in the ring (k,)."""
    k, v = len(ring), 0
    while v < k and nis[corners[v], row[ring[v + shift - (k if v + shift >= k else 0)]]] <= gate:
        v += 1
    return v == k


@compiled
def _turn(ring: Ints, shift: int, turned: Ints) -> None:
    """Write the ring (k,) from its vertex `shift` on."""
    for v in range(ring.shape[0]):
        turned[v] = ring[(v + shift) % ring.shape[0]]


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
    rings = view.rings.get(len(polygon.corners))
    if rings is None:
        return None
    gate = chi2_gate(2, config.gate_probability)
    ids, known = _plausible(polygon, rings, view, nis, 2.0 * gate)  # generous: the joint test decides
    if not len(ids):
        return None
    joint_gate = chi2_gate(2 * len(polygon.corners), config.gate_probability)
    z, R = corners.measurements(polygon.corners)
    hypotheses = []
    for ring, c in zip(ids, known.tolist(), strict=True):
        if belief.mean_of_gaussians_nis(z, R, ring, paper_S=config.paper_S) > gate:
            continue
        joint = belief.joint_nis(z, R, ring)
        if joint <= joint_gate:
            hypotheses.append((joint, int(rings.index[c]), ring))
    return _agreed(hypotheses, polygon.corners)


def _plausible(polygon: Polygon, rings: Rings, view: MapView, nis: Array, gate: float) -> tuple[Ints, Ints]:
    """Ids (h,k) of known rings as `plausible_rings` writes them, and which of `rings` (h,) they are."""
    count, k = rings.ids.shape
    ids, known = np.empty((count * k, k), np.int64), np.empty(count * k, np.int64)
    h = plausible_rings(nis, polygon.corners, view.belief.ids, view.features.state, rings.ids, gate, ids, known)
    return ids[:h], known[:h]


def _agreed(hypotheses: list[tuple[float, int, Ints]], corners: Ints) -> tuple[int, Ints, Ints, float] | None:
    """The best hypothesis, cut down to the vertices on which all serious rivals agree; None under three of them."""
    if not hypotheses:
        return None
    nis, known, ids = min(hypotheses, key=lambda h: (h[0], h[1]))
    if len(hypotheses) == 1:
        return known, corners, ids, nis
    agreed = np.ones(len(ids), np.bool_)
    for rival in hypotheses:
        if rival[0] < nis + AMBIGUITY_GAP:
            agreed &= rival[2] == ids
    if agreed.sum() < 3:
        return None
    return known, corners[agreed], ids[agreed], nis
