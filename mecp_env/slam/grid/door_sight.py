"""Compiled functions of what is seen through a door: the line of the door cuts the free space of a scan."""

from __future__ import annotations

import numpy as np

from mecp_env.core.array_types import Array
from mecp_env.core.jit import compiled


@compiled
def split_outline(outline: Array, eye: Array, door: Array) -> tuple[Array, Array]:
    """Free space (m,2) seen from `eye` (2,), in the order of bearing, as cut by a door (2,2): before it and behind it.

    Behind is empty when nothing is seen through the door.
    """
    count, n, m = outline.shape[0], 0, 0
    front, behind = np.empty((4 * count, 2)), np.empty((4 * count, 2))
    ax, ay, bx, by = door_ends(eye, door)
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        px, py, qx, qy = outline[i, 0] - eye[0], outline[i, 1] - eye[1], outline[j, 0] - eye[0], outline[j, 1] - eye[1]
        share, share_q = door_share(ax, ay, bx, by, px, py), door_share(ax, ay, bx, by, qx, qy)
        right, left = crossing_stretch(px, py, qx, qy, ax, ay), crossing_stretch(px, py, qx, qy, bx, by)
        n = _put(front, n, eye, min(share, 1.0) * px, min(share, 1.0) * py)
        if share < 1.0:
            m = _put(behind, m, eye, px, py)
        if right > 1.0:  # the outline goes behind the door past its right end
            n = _put(front, _put(front, n, eye, right * ax, right * ay), eye, ax, ay)
            m = _put(behind, _put(behind, m, eye, ax, ay), eye, right * ax, right * ay)
        if left > 1.0:  # and comes back past its left end
            n = _put(front, _put(front, n, eye, bx, by), eye, left * bx, left * by)
            m = _put(behind, _put(behind, m, eye, left * bx, left * by), eye, bx, by)
        if (share_q < 1.0 <= share and right <= 1.0) or (share < 1.0 <= share_q and left <= 1.0):  # or through it
            ex, ey, dx, dy = qx - px, qy - py, bx - ax, by - ay
            across = ex * dy - ey * dx  # 0: the edge lies on the door's line
            along = ((ax - px) * dy - (ay - py) * dx) / across if abs(across) > 1e-9 else 0.0
            n = _put(front, n, eye, px + along * ex, py + along * ey)
            m = _put(behind, m, eye, px + along * ex, py + along * ey)
    return front[:n].copy(), behind[:m].copy()


@compiled
def _put(ring: Array, n: int, eye: Array, x: float, y: float) -> int:
    """Write a point, given from the eye (2,), into row n of the ring; returns the next row."""
    ring[n, 0], ring[n, 1] = eye[0] + x, eye[1] + y
    return n + 1


@compiled
def door_ends(eye: Array, door: Array) -> tuple[float, float, float, float]:
    """Right and left end x, y of a door (2,2) as seen from the eye (2,), relative to it."""
    ax, ay, bx, by = door[0, 0] - eye[0], door[0, 1] - eye[1], door[1, 0] - eye[0], door[1, 1] - eye[1]
    if ax * by - ay * bx > 0.0:
        return ax, ay, bx, by
    return bx, by, ax, ay


@compiled
def door_share(ax: float, ay: float, bx: float, by: float, px: float, py: float) -> float:
    """Share of the way from the origin to p at which it crosses the segment from a (right) to b; 2: nowhere."""
    if ax * py - ay * px < 0.0 or px * by - py * bx < 0.0:
        return 2.0
    across = px * (by - ay) - py * (bx - ax)
    return (ax * by - ay * bx) / across if across > 1e-12 else 2.0


@compiled
def crossing_stretch(px: float, py: float, qx: float, qy: float, ax: float, ay: float) -> float:
    """How far out, in lengths of a, the edge from p to q crosses the ray through a counter-clockwise; 0: nowhere."""
    before, after = ax * py - ay * px, ax * qy - ay * qx
    if before >= 0.0 or after < 0.0:
        return 0.0
    return (px * qy - py * qx) / (after - before)


@compiled
def looks_through(outline: Array, eye: Array, door: Array) -> bool:
    """True when some of the free space (m,2) seen from `eye` (2,) lies behind the door (2,2)."""
    ax, ay, bx, by = door_ends(eye, door)
    for i in range(outline.shape[0]):
        px, py = outline[i - 1, 0] - eye[0], outline[i - 1, 1] - eye[1]
        qx, qy = outline[i, 0] - eye[0], outline[i, 1] - eye[1]
        if door_share(ax, ay, bx, by, qx, qy) < 1.0 or crossing_stretch(px, py, qx, qy, ax, ay) > 1.0:
            return True
    return False
