"""Rooms as closed walls, seen by a NumPy laser: beams and the truly visible corners."""

import numpy as np
import shapely

from mecp_env.core.se2 import to_robot
from mecp_env.slam.messages import CornerKind
from tests.slam import make, scans
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
    return np.concatenate([scans.ring(*points) for points in rings])


def sees(walls, origin, points):
    """(n,) whether nothing lies between origin and each point; touching a corner does not count."""
    offset = points - origin
    return scans.cast(walls - origin, np.arctan2(offset[:, 1], offset[:, 0])) > np.hypot(*offset.T) - 1e-6


def beams_of(walls, pose, rng=None, sigma=0.0):
    """The beams of a scan at pose (3,)."""
    ranges = scans.cast(walls - pose[:2], MIDDLES + pose[2])
    noise = 0.0 if rng is None else rng.normal(0, sigma, 720)
    return make.beams(np.minimum(ranges + noise, make.MAX_RANGE_M), MIDDLES, ranges < make.MAX_RANGE_M)


def corners_of(points, pose, *, kinds=None, doors=()):
    """Corners at the points (n,2) of the world, in order of bearing; doors are pairs of indices of points."""
    z = make.polar(to_robot(pose, np.array(points, float).reshape(-1, 2)))
    order, n = np.argsort(z[:, 1]), len(z)
    z = z[order]
    sigmas = 0.005 * np.column_stack([np.ones(n), 1.0 / z[:, 0]]).ravel()
    kind = np.full(n, CornerKind.CROSSING) if kinds is None else np.asarray(kinds)[order]
    gaps = make.doorways(np.argsort(order)[np.array(doors, np.int64)])
    return make.corners(z, cov=np.diag(sigmas**2), gaps=gaps, kind=kind, normals=np.nan, sites=kind != CornerKind.JAMB)


def poses_in(ring, count, rng, holes=(), margin=0.25):
    """`count` random poses in the ring, `margin` off all walls, outside the holes."""
    floor, found = shapely.Polygon(ring, holes).buffer(-margin), []
    while len(found) < count:
        p = rng.uniform(np.min(ring, axis=0), np.max(ring, axis=0))
        if floor.contains(shapely.Point(p)):
            found.append(np.array([*p, rng.uniform(-np.pi, np.pi)]))
    return found


def wall_inside(walls, ring):
    """How much wall (m) lies in the convex ring (k,2), 1 mm of rounding left out."""
    return shapely.Polygon(ring).buffer(-1e-3).intersection(shapely.MultiLineString([*walls])).length
