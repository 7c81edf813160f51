"""Constructed scans: rays against faces in NumPy, with the bearings and noise of the laser."""

import numpy as np

from mecp_env.core.se2 import polar_to_points, to_robot
from mecp_env.slam.config import SensorModel
from tests.slam import make
from tests.slam.frontend.make import PAPER, front_end
from tests.slam.make import MAX_RANGE_M, nominal_bearings

EXACT = SensorModel(range_sigma_m=0.0, bearing_sigma_deg=0.0)
LMS200 = SensorModel(range_sigma_m=0.01, bearing_sigma_deg=0.0)
GROWING = SensorModel(range_sigma_m=0.01, range_sigma_share=0.01, bearing_sigma_deg=0.0)


def ring(*points):
    """Faces (n,2,2) from each point to the next and back to the first."""
    p = np.array(points, dtype=float)
    return np.stack([p, np.roll(p, -1, axis=0)], axis=1)


def chain(*points):
    """Faces (n-1,2,2) from each point to the next."""
    return ring(*points)[:-1]


def moved(faces, T):
    """The faces in the frame of a robot at T."""
    return to_robot(np.asarray(T, float), faces.reshape(-1, 2)).reshape(faces.shape)


def turned(faces, angle):
    """The faces as a robot sees them that is turned by -angle."""
    return moved(faces, (0.0, 0.0, -angle))


def cast(faces, bearings):
    """Exact range of each ray from the origin, inf where there is none."""
    return distances(faces, bearings).min(axis=-1)


def distances(faces, bearings):
    """(...,n) along each ray to each face, inf where it is not met."""
    d = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)[..., None, :]
    a, u = faces[:, 0], faces[:, 1] - faces[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        across = d[..., 0] * u[:, 1] - d[..., 1] * u[:, 0]
        r = (a[:, 0] * u[:, 1] - a[:, 1] * u[:, 0]) / across
        t = (a[:, 0] * d[..., 1] - a[:, 1] * d[..., 0]) / across
    return np.where((r > 0.0) & (t >= 0.0) & (t <= 1.0), r, np.inf)


def take_scan(faces, sensor=PAPER, seed=0, sweeps=4, beams=720, max_range_m=MAX_RANGE_M):
    """A burst at the origin among `faces`."""
    rng = np.random.default_rng(seed)
    bearings = nominal_bearings(sweeps, beams)
    ranges = cast(faces, bearings + rng.normal(0.0, 1.0, bearings.shape) * sensor.bearing_sigma_rad)
    sigma_m = np.maximum(sensor.range_sigma_m, sensor.range_sigma_share * np.minimum(ranges, max_range_m))
    ranges = ranges + rng.normal(0.0, 1.0, bearings.shape) * sigma_m
    return make.scan(ranges, bearings, max_range_m=max_range_m)


def blank_scan(sweeps=4, beams=720):
    """A burst that hit nothing."""
    return make.scan(np.full((sweeps, beams), MAX_RANGE_M))


def corners_of(faces, sensor=PAPER, seed=0, sweeps=4):
    """The corners of one scan of `faces`, and their points (n,2)."""
    corners = front_end(take_scan(faces, sensor, seed, sweeps), sensor)[-1]
    return corners, polar_to_points(corners.z)


ROOM = ring((3.0, -1.5), (3.0, 2.0), (-2.0, 2.0), (-2.0, -1.5))
