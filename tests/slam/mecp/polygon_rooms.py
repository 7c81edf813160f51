"""Rooms as closed walls, seen by a NumPy laser: beams and the truly visible corners."""

from __future__ import annotations

import numpy as np

from mecp_env.slam.messages import CornerKind
from tests.slam import make
from tests.slam.make import MIDDLES

ROOMS = {
    "rectangle": [(0, 0), (6, 0), (6, 4), (0, 4)],
    "L": [(0, 0), (7, 0), (7, 3), (3, 3), (3, 6), (0, 6)],
    "T": [(2, 0), (5, 0), (5, 3), (7, 3), (7, 6), (0, 6), (0, 3), (2, 3)],
    "U": [(0, 0), (8, 0), (8, 6), (5, 6), (5, 3), (3, 3), (3, 6), (0, 6)],
    "Z": [(0, 0), (5, 0), (5, 3), (8, 3), (8, 7), (3, 7), (3, 4), (0, 4)],
    "cross": [(2, 0), (4, 0), (4, 2), (6, 2), (6, 4), (4, 4), (4, 6), (2, 6), (2, 4), (0, 4), (0, 2), (2, 2)],
}
BOX = [(2.6, 1.3), (2.6, 2.1), (3.4, 2.1), (3.4, 1.3)]


def walls_of(*rings):
    """Faces (S,2,2) of closed rings."""
    return np.concatenate([np.stack([np.asarray(r, float), np.roll(np.asarray(r, float), -1, 0)], 1) for r in rings])


def hit_ranges(walls, origin, directions):
    """Distance (m,) from origin to the nearest wall along each unit direction (m,2); inf without one."""
    a, d = walls[:, 0] - origin, walls[:, 1] - walls[:, 0]
    across = directions[:, None, 0] * d[:, 1] - directions[:, None, 1] * d[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (a[:, 0] * d[:, 1] - a[:, 1] * d[:, 0]) / across
        s = (a[:, 0] * directions[:, None, 1] - a[:, 1] * directions[:, None, 0]) / across
    good = (t > 1e-9) & (s >= -1e-9) & (s <= 1 + 1e-9)
    return np.where(good, t, np.inf).min(axis=1)


def sees(walls, origin, points):
    """(n,) whether nothing lies between origin and each point; touching a corner does not count."""
    offset = points - origin
    distance = np.hypot(*offset.T)
    return hit_ranges(walls, origin, offset / distance[:, None]) > distance - 1e-6


def beams_of(walls, pose, rng=None, sigma=0.0, max_range=30.0):
    """The beams of a scan at pose (3,)."""
    angles = MIDDLES + pose[2]
    ranges = hit_ranges(walls, np.asarray(pose[:2]), np.column_stack([np.cos(angles), np.sin(angles)]))
    hit = ranges < max_range
    ranges = np.minimum(ranges + (0.0 if rng is None else rng.normal(0, sigma, 720)), max_range)
    return make.beams(ranges, MIDDLES, hit, max_range_m=max_range)


def corners_of(points, pose, *, sigma=0.005, kinds=None, doors=()):
    """Corners at the points (n,2) of the world, in order of bearing; doors are pairs of indices of points."""
    offset = np.asarray(points, float).reshape(-1, 2) - pose[:2]
    bearing = np.mod(np.arctan2(offset[:, 1], offset[:, 0]) - pose[2] + np.pi, 2 * np.pi) - np.pi
    order = np.argsort(bearing)
    z = np.column_stack([np.hypot(*offset.T), bearing])[order]
    n = len(z)
    spread = np.column_stack([np.full(n, sigma), sigma / z[:, 0]]).ravel()
    kind = np.full(n, CornerKind.CROSSING) if kinds is None else np.asarray(kinds)[order]
    gaps = make.doorways(np.argsort(order)[np.array(doors, np.int64)])
    marks = {"kind": kind, "normals": np.nan, "sites": kind != CornerKind.JAMB}
    return make.corners(z, cov=np.diag(spread**2), gaps=gaps, **marks)


def inside(ring, point):
    """True when the point lies in the simple ring."""
    ring = np.asarray(ring, float)
    a, b = ring, np.roll(ring, -1, 0)
    spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool(np.count_nonzero(spans & (point[0] < x)) % 2)


def poses_in(ring, count, rng, holes=(), margin=0.25):
    """`count` random poses in the ring, `margin` off all walls, outside the holes."""
    walls = walls_of(ring, *holes)
    low, high = np.min(ring, axis=0), np.max(ring, axis=0)
    found = []
    while len(found) < count:
        p = rng.uniform(low, high)
        if inside(ring, p) and not any(inside(h, p) for h in holes) and distance_to(walls, p) > margin:
            found.append(np.array([*p, rng.uniform(-np.pi, np.pi)]))
    return found


def distance_to(walls, p):
    """Distance from p to the nearest wall."""
    a, d = walls[:, 0], walls[:, 1] - walls[:, 0]
    t = np.clip(((p - a) * d).sum(1) / (d * d).sum(1), 0, 1)
    return float(np.hypot(*(a + t[:, None] * d - p).T).min())


def to_world(pose, z):
    """Points (n,2) in the world of ranges and bearings (n,2) measured at pose."""
    angle = z[:, 1] + pose[2]
    return pose[:2] + z[:, :1] * np.column_stack([np.cos(angle), np.sin(angle)])


def wall_inside(walls, ring):
    """How much wall (m) lies in the open convex ring (k,2), 1 mm of rounding left out."""
    a, d = walls[:, 0], walls[:, 1] - walls[:, 0]
    enter, leave = np.zeros(len(walls)), np.ones(len(walls))
    for p, q in zip(ring, np.roll(ring, -1, 0), strict=True):
        normal = np.array([p[1] - q[1], q[0] - p[0]]) / np.hypot(*(q - p))
        depth, slope = (a - p) @ normal - 1e-3, d @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = -depth / slope
        enter = np.where(slope > 1e-12, np.maximum(enter, t), enter)
        leave = np.where(slope < -1e-12, np.minimum(leave, t), leave)
        leave = np.where((np.abs(slope) <= 1e-12) & (depth <= 0), -1.0, leave)
    return float((np.maximum(leave - enter, 0.0) * np.hypot(*d.T)).sum())
