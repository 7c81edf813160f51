"""From a mask of floor pixels to the polygon of the floor in metres."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import contourpy
import numpy as np
import shapely
from scipy import ndimage
from shapely.geometry import Polygon

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LayoutError, PlanWarning

MAX_CELLS = 4_000_000  # of the box around the floor; with more, several pixels become one
SPECK_CELLS = 4  # pieces of wall of at most so many cells that stand free are noise
MAX_SPECKS = 5_000  # larger ones
MAX_CORNERS = 400_000
CLEANED = "erase noise with a median filter, or scale the picture down and give the metres per pixel of the smaller one"
LEAST_NOISE_M = 0.03
OUTSIDE_EDGE, OUTSIDE_WITHIN = 0.9, 0.1  # of the edge is floor, and so much of its area again is closed off within it
FRAMED_WITHIN = 1.0  # the same where there is a frame around the floor, as walls around a large room are
ROOM_M2 = 4.0  # a piece of floor of this size or more may be a room


@dataclass(frozen=True, slots=True)
class Placement:
    """The pose of an image in the world."""

    resolution_m: float  # side of a pixel
    origin: tuple[float, float] = (0.0, 0.0)  # m, the lower left corner of the lower left pixel
    yaw: float = 0.0  # rad, of the image's x axis

    @property
    def noise_m(self) -> float:
        """How far an edge may be from its pixels, m."""
        return max(LEAST_NOISE_M, min(1.2 * self.resolution_m, 0.05 + 0.5 * self.resolution_m))

    def to_world(self, pixels: Array) -> Array:
        """Points (n,2) in m of points (n,2) in pixels, column and row from below."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        turned: Array = self.resolution_m * pixels @ np.array([(cos, sin), (-sin, cos)]) + self.origin
        return turned


def floor_polygon(free: Bools, placement: Placement, told: bool = False) -> Polygon:
    """The largest connected floor of the mask `free` (h,w), row 0 at the top, in m.

    Warns where it seems to be the outside of a building or other parts may be rooms, unless a doubt about `free` was
    `told`. Raises LayoutError when there is none, and when there is more than can be worked on in a moment.
    """
    rows, columns = np.flatnonzero(free.any(axis=1)), np.flatnonzero(free.any(axis=0))
    if not len(rows):
        raise LayoutError("image: no pixel is floor; check free_thresh, negate and mode of its yaml, or free_above")
    top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
    side = _pooled_side(int((bottom - top) * (right - left)), placement.resolution_m)
    pooled = _pooled(free[top:bottom, left:right][::-1], side)
    largest, others_m2 = _largest(pooled, (side * placement.resolution_m) ** 2)
    framed = free.shape != (bottom - top, right - left)
    if not told and (doubt := _outside(largest, pooled, framed) or _closed_off(others_m2)):
        warnings.warn(f"image: {doubt}", PlanWarning, stacklevel=3)
    floor = _without_specks(largest)
    polygon = _contour(np.pad(floor, 1))
    corner = np.array([left, len(free) - bottom], np.float64)  # column and row from below
    return shapely.transform(polygon, lambda points: placement.to_world(side * (points - 0.5) + corner))


def _pooled_side(cells: int, resolution_m: float) -> int:
    """How many pixels each way become one, so that few enough of `cells` are left; warns where it is not 1."""
    side = math.ceil(math.sqrt(cells / MAX_CELLS))
    if side > 1:
        said = f"{cells} pixels around the floor: {side} x {side} are read as one of {side * resolution_m:g} m"
        warnings.warn(f"image: {said}", PlanWarning, stacklevel=4)
    return side


def _pooled(free: Bools, side: int) -> Bools:
    """`free` in squares of `side` pixels: not free where a wall of one pixel goes through."""
    if side == 1:
        return free
    height, width = (-(-length // side) * side for length in free.shape)
    walls = np.ones((height, width), np.bool_)
    walls[: free.shape[0], : free.shape[1]] = ~free
    counts = walls.reshape(height // side, side, width // side, side).sum(axis=(1, 3))
    return np.asarray(counts < side, np.bool_)


def _largest(free: Bools, cell_m2: float) -> tuple[Bools, list[float]]:
    """The largest 4-connected part of `free`, and the sizes in m2 of others that may be rooms.

    What is around it, as the margin of a picture, is no room.
    """
    parts, count = ndimage.label(free)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    sizes[0] = 0
    chosen = int(np.argmax(sizes))
    rooms = [chosen, *(part for part in np.flatnonzero(sizes * cell_m2 >= ROOM_M2).tolist() if part != chosen)]
    number = np.zeros(count + 1, np.int32)
    number[rooms] = np.arange(1, len(rooms) + 1)
    boxes: list[Any] = ndimage.find_objects(number[parts]) if len(rooms) > 1 else []
    others = [part for part, box in zip(rooms, boxes, strict=False) if part != chosen and not _is_around(box, boxes[0])]
    largest: Bools = parts == chosen
    return largest, [float(sizes[part] * cell_m2) for part in others]


def _is_around(outer: tuple[slice, slice], inner: tuple[slice, slice]) -> bool:
    return all(o.start < i.start and i.stop < o.stop for o, i in zip(outer, inner, strict=True))


def _outside(floor: Bools, free: Bools, framed: bool) -> str:
    """That the largest part of a picture is along its edge and around other parts, as the outside is; or nothing.

    Within a frame only free parts count, since a corridor may go around a solid core.
    """
    edge = np.concatenate([floor[0], floor[-1], floor[:, 0], floor[:, -1]])
    if edge.mean() < OUTSIDE_EDGE:
        return ""
    within = ndimage.binary_fill_holes(floor) & ~floor & (free | (not framed))
    if np.count_nonzero(within) < (FRAMED_WITHIN if framed else OUTSIDE_WITHIN) * np.count_nonzero(floor):
        return ""
    said = "the floor read lies along the edge or frame of the picture and around closed parts, as the outside does"
    return f"{said}; paint the outside black, cut the margin off, or swap black and white"


def _closed_off(sizes_m2: list[float]) -> str:
    """How much floor no opening leads to, in words; or nothing."""
    if not sizes_m2:
        return ""
    return f"closed parts as large as a room are left out: {len(sizes_m2)}, of {sum(sizes_m2):.0f} m2 in all"


def _without_specks(floor: Bools) -> Bools:
    """`floor` where free-standing walls of a few pixels are floor."""
    parts, _ = ndimage.label(~floor, structure=np.ones((3, 3)))
    specks = np.bincount(parts.ravel()) <= SPECK_CELLS
    pieces = len(specks) - np.count_nonzero(specks)
    if pieces > MAX_SPECKS:
        raise LayoutError(f"image: {pieces} pieces of wall, at most {MAX_SPECKS}; {CLEANED}")
    return floor | specks[parts]


def _contour(floor: Bools) -> Polygon:
    """The outline of `floor` in pixels, between the centres of its pixels and of those beside them."""
    corners = sum(int(np.count_nonzero(np.diff(floor, axis=axis))) for axis in (0, 1))  # one at each edge of a pixel
    if corners > MAX_CORNERS:
        raise LayoutError(f"image: its walls have {corners} corners, at most {MAX_CORNERS}; {CLEANED}")
    generator = contourpy.contour_generator(z=floor.astype(np.float64), fill_type=contourpy.FillType.OuterOffset)
    filled: Any = generator.filled(0.5, 2.0)
    points, offsets = filled
    outlines = [
        Polygon(ring_points[ends[0] : ends[1]], [ring_points[a:b] for a, b in pairwise(ends[1:])])
        for ring_points, ends in zip(points, offsets, strict=True)
    ]
    return max(outlines, key=lambda outline: outline.area)
