"""Edges as a draughtsman would draw them: staircases made straight, edges turned to the building's directions.

A ring is thinned (Douglas-Peucker), each of its edges becomes a line: along a direction of the building where that
stays near to what was drawn, else through its two ends. Lines with the same direction and nearly the same offset are
joined. The corners are where neighbouring lines cross.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.geometry.polygon import orient

from mecp_env.core.carriers import Array
from mecp_env.world.outline import thin_walls_m

FINE = 0.4  # of the noise: walls of one pixel keep their direction only in a finer drawing
# shares of the noise, one pair after the other until nothing crosses and no wall is lost: what is believed, and what
# may be between faces of one line; walls as thin as a pixel are less than that apart
BELIEVED = ((1.0, 1.0), (1.0, 0.5), (1.0, 0.25), (1.0, 0.0), (0.6, 0.6), (0.4, 0.4))
LEAST_WALL_M = 0.01  # a thinner one is lost
BEVEL = 4.0  # times the noise: a shorter edge between two square ones is their blurred corner
END, MOST_OF_END = 3.0, 8  # times the noise: the end of a wall may be so uneven, of fewer lines
THIN = 0.75  # of the noise, for the vertices that stay
AXES = 3  # directions that a building may have, each with its square
AXIS_SHARE = 0.12  # of the length of all edges, for a direction to be one of the building
ONE_AXIS, OTHER_AXIS = math.radians(2.0), math.radians(10.0)  # edges nearer are of one, further of another direction
DRAWN_AXIS = math.radians(3.0)  # an edge of a drawing that is nearer goes along it
BINS, SPREAD = 360, 6  # of a quarter of a degree; a peak is so many bins wide on either side
LEVEL = math.radians(0.25)  # a building turned by less is along x and y
NEAR_AXIS = math.radians(40.0)  # no edge is turned by more
PARALLEL = 0.999  # the cosine of two edges along one direction is above
BLUNT = math.radians(20.0)  # lines that meet at less have their corner where it was drawn


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """An edge that is being straightened."""

    angle: float  # rad, along the ring
    offset: float  # m, of the line from the origin, to the left of its direction
    length: float  # m
    middle: Array  # (2,) m, of what was drawn
    end: Array  # (2,) m, the corner drawn between this edge and the next
    on_axis: bool

    def cosine(self, other: Line) -> float:
        """That of the angle to another edge, 0 where one of both is not along a direction of the building."""
        return math.cos(self.angle - other.angle) if self.on_axis and other.on_axis else 0.0


class Try(NamedTuple):
    """A straightened floor."""

    crossing: int  # rings left as they were, for their edges would cross
    lost_m: float  # length of the walls whose faces coincide
    area: Polygon


def straightened(area: Polygon, noise_m: float, turn: bool = True) -> Polygon:
    """`area` with straight edges, none further than about twice `noise_m` from where it was; `turn` to directions.

    Where straight edges would cross, or both faces of a wall be one, less noise is believed; where they still cross,
    the edges of that ring, or of all, are only thinned.
    """
    drawn = _from_corners(area, noise_m)
    turned = _soundest(drawn, noise_m) if turn else None
    return thinned(drawn, noise_m) if turned is None else orient(shapely.simplify(turned, noise_m / 10.0), 1.0)


def _soundest(drawn: Polygon, noise_m: float) -> Polygon | None:
    """`drawn` with the edges of its rings along lines: of as many rings, and with as few walls lost, as can be."""
    best: Try | None = None
    for share, in_line in BELIEVED:
        if best and not best.crossing and (share < 1.0 or best.lost_m == 0.0):
            break
        turned, crossing = _turned(drawn, share * noise_m, in_line * noise_m)
        if turned.is_valid:
            found = Try(crossing, thin_walls_m(turned, LEAST_WALL_M), turned)
            best = min(best or found, found, key=lambda one: one[:2])
    return best and best.area


def _turned(drawn: Polygon, noise_m: float, in_line_m: float) -> tuple[Polygon, int]:
    """`drawn` with its edges along lines; rings may cross each other, those that cross themselves (how many) stay."""
    thin = thinned(drawn, noise_m)
    axes = max((_voted(thin), _voted(thinned(drawn, FINE * noise_m))))[1]
    rings = [_lines(chains, noise_m, axes) for chains in map(_chains, _rings(drawn), _rings(thin))]
    rings = _aligned([_merged(_squared(lines, noise_m), noise_m) for lines in rings], in_line_m)
    corners = [_corners(lines, noise_m) for lines in rings]
    sound = [len(new) >= 3 and Polygon(new).is_valid for new in corners]
    kept = [new if fits else old for new, old, fits in zip(corners, _rings(thin), sound, strict=True)]
    return Polygon(kept[0], kept[1:]), sound.count(False)


def thinned(area: Polygon, noise_m: float) -> Polygon:
    """`area` without the vertices that lie less than a share of `noise_m` beside its edges."""
    return orient(shapely.simplify(area, THIN * noise_m), 1.0)


def directions(area: Polygon) -> tuple[float, ...]:
    """Directions (rad, modulo a right angle) that most edges of `area` have; the main one first."""
    return _voted(area)[1]


def along_directions(area: Polygon) -> float:
    """The share of the length of all edges of `area` that goes along one of its directions."""
    length, angle = _edges(area)
    near = [np.abs(quarter(angle - axis)) < DRAWN_AXIS for axis in directions(area)]
    return float(length[np.logical_or.reduce(near)].sum() / length.sum()) if near else 0.0


def _voted(area: Polygon) -> tuple[float, tuple[float, ...]]:
    """The share of all edges that have the main direction, and the directions."""
    length, angle = _edges(area)
    weight = length**2 / (length + 0.5)  # a short edge says little about a direction
    found: list[tuple[float, float]] = []
    for _ in range(AXES):
        near = np.abs(quarter(angle - _peak(angle, weight))) < ONE_AXIS
        share = float(weight[near].sum() / length.sum())
        if share < AXIS_SHARE:
            break
        first = angle[near][int(np.argmax(weight[near]))]
        axis = float(quarter(first + np.average(quarter(angle[near] - first), weights=weight[near])))
        found.append((share, 0.0 if abs(axis) < LEVEL else axis))
        weight = np.where(np.abs(quarter(angle - axis)) < OTHER_AXIS, 0.0, weight)
    return found[0][0] if found else 0.0, tuple(axis for _, axis in found)


def _edges(area: Polygon) -> tuple[Array, Array]:
    """The lengths (n,) of all edges, and their directions (n,), rad modulo a right angle."""
    edges = np.concatenate([np.diff(ring, axis=0) for ring in _rings(area)])
    return np.hypot(*edges.T), quarter(np.arctan2(edges[:, 1], edges[:, 0]))


def _peak(angle: Array, weight: Array) -> float:
    """The direction around which most `weight` (n,) lies."""
    bins = ((angle + math.pi / 4.0) * (BINS / (math.pi / 2.0))).astype(np.int64) % BINS
    counts = np.bincount(bins, weights=weight, minlength=BINS)
    spread = sum(np.roll(counts, shift) for shift in range(-SPREAD, SPREAD + 1))
    return float((int(np.argmax(spread)) + 0.5) * (math.pi / 2.0) / BINS - math.pi / 4.0)


def quarter(angle: Any) -> Any:
    """`angle` modulo a right angle, in [-pi/4, pi/4)."""
    return np.mod(angle + math.pi / 4.0, math.pi / 2.0) - math.pi / 4.0


def _rings(area: Polygon) -> list[Array]:
    """The closed rings (n,2) of `area`."""
    return [np.array(ring.coords) for ring in (area.exterior, *area.interiors)]


def _from_corners(area: Polygon, noise_m: float) -> Polygon:
    """`area`, the outline counter-clockwise, with rings that start where their longest edge starts.

    A ring that begins amid an edge has a corner there that is none; the end of a wall would be cut in two.
    """
    rings = [ring[:-1] for ring in _rings(orient(area, 1.0))]
    turned = [np.roll(ring, -int(np.argmax(np.hypot(*(ring - ring.mean(axis=0)).T))), axis=0) for ring in rings]
    turned = [np.roll(ring, -_longest(ring, noise_m), axis=0) for ring in turned]
    return Polygon(turned[0], turned[1:])


def _longest(ring: Array, noise_m: float) -> int:
    """Index in an open ring (n,2), which begins at a corner, of the start of its longest edge."""
    thin = shapely.get_coordinates(shapely.simplify(shapely.linearrings(ring), THIN * noise_m))
    start = thin[int(np.argmax(np.hypot(*np.diff(thin, axis=0).T)))]
    return int(np.argmax((ring == start).all(axis=1)))


def _chains(drawn: Array, thin: Array) -> list[Array]:
    """The points (n,2) of the ring as `drawn` along each edge of the `thin` one, whose vertices are among them."""
    place = {point: i for i, point in enumerate(map(tuple, drawn[:-1].tolist()))}
    ends = [place[point] for point in map(tuple, thin.tolist())]
    steps = [(b - a) % (len(drawn) - 1) for a, b in pairwise(ends)]
    if sum(steps) != len(drawn) - 1:  # the ring comes twice to one point
        return [np.stack(pair) for pair in pairwise(thin)]
    around = np.concatenate([drawn[:-1], drawn])
    return [around[a : a + step + 1] for a, step in zip(ends[:-1], steps, strict=True)]


def _lines(chains: list[Array], noise_m: float, axes: tuple[float, ...]) -> list[Line]:
    """The line of each chain, along an axis where it ends less than twice `noise_m` beside its corners.

    Short chains that follow each other are one: the blurred end of a wall.
    """
    joined: list[Array] = []
    for chain in chains:
        if joined and max(_span(joined[-1]), _span(chain)) < 2.5 * noise_m:
            joined[-1] = np.concatenate([joined[-1], chain[1:]])
        else:
            joined.append(chain)
    return [_line(chain, noise_m, axes) for chain in joined]


def _span(chain: Array) -> float:
    return math.dist(chain[0], chain[-1])


def _line(chain: Array, noise_m: float, axes: tuple[float, ...]) -> Line:
    step = chain[-1] - chain[0]
    length, angle = math.hypot(*step), math.atan2(step[1], step[0])
    off = min((float(quarter(axis - angle)) for axis in axes), key=abs, default=math.inf)
    on_axis = abs(off) < NEAR_AXIS and length * abs(math.sin(off)) <= 2.0 * noise_m
    angle = angle + off if on_axis else angle
    pieces = np.hypot(*(chain[1:] - chain[:-1]).T)
    middle = pieces @ (chain[1:] + chain[:-1]) / (2.0 * pieces.sum())
    return Line(angle, _offset(angle, middle), length, middle, chain[-1], on_axis)


def _offset(angle: float, point: Array) -> float:
    return float(point[1] * math.cos(angle) - point[0] * math.sin(angle))


def _squared(lines: list[Line], noise_m: float) -> list[Line]:
    """`lines` of a ring without bevels between lines that are square to each other; the ends of walls are square."""
    lines = _with_whole_ends(lines, noise_m)
    kept = []
    for before, line, after in zip([lines[-1], *lines[:-1]], lines, [*lines[1:], lines[0]], strict=True):
        bevel = before.on_axis and after.on_axis and _is_oblique(line, before, noise_m)
        turn = before.cosine(after)
        if bevel and turn < -PARALLEL:
            kept.append(_end_of_wall(before, line))
        elif not bevel or abs(turn) > 0.1:
            kept.append(line)
    return kept


def _with_whole_ends(lines: list[Line], noise_m: float) -> list[Line]:
    """`lines` of a ring with one line for several that are the blurred end of a wall, or a door frame in it."""
    whole: list[Line] = []
    rest = [*lines, lines[0]]
    while len(rest) > 1:
        face, *rest = rest
        whole.append(face)
        count = _lines_of_end(face, rest, noise_m)
        if count:
            length = sum(line.length for line in rest[:count])
            middle = sum((line.length * line.middle for line in rest[:count]), start=np.zeros(2)) / length
            whole.append(_end_of_wall(face, replace(rest[count - 1], length=length, middle=middle)))
            rest = rest[count:]
    return whole


def _lines_of_end(face: Line, after: list[Line], noise_m: float) -> int:
    """How many of the lines `after` one face of a wall are its end, before the other face; 0 where it has no end."""
    reach = END * noise_m
    ahead = np.array([math.cos(face.angle), math.sin(face.angle)])
    for count in range(2, min(MOST_OF_END, len(after))):
        steps = np.array([line.end - face.end for line in after[:count]])
        along, across = steps @ ahead, steps @ (-ahead[1], ahead[0])
        if np.abs(along).max() > reach or np.ptp(along) > reach:
            return 0
        between = np.abs(across - across[-1] / 2.0).max() <= abs(across[-1]) / 2.0 + noise_m
        if between and face.cosine(after[count]) < -PARALLEL and min(face.length, after[count].length) > reach:
            return count
    return 0


def _is_oblique(line: Line, face: Line, noise_m: float) -> bool:
    """Whether a short line is neither along nor square to a face; it may go along another direction of the building."""
    return line.length < BEVEL * noise_m and abs(math.sin(2.0 * (line.angle - face.angle))) > 1e-3


def _end_of_wall(face: Line, line: Line) -> Line:
    """`line` turned square to a face of the wall that it ends."""
    square = face.angle + math.copysign(math.pi / 2.0, math.sin(line.angle - face.angle))
    return replace(line, angle=square, offset=_offset(square, line.middle), on_axis=True)


def _is_one(a: Line, b: Line, noise_m: float) -> bool:
    return a.cosine(b) > PARALLEL and abs(a.offset - b.offset) <= noise_m


def _merged(lines: list[Line], noise_m: float) -> list[Line]:
    """`lines` of a ring with neighbours that are one line joined; a step is left between others that are parallel."""
    joined: list[Line] = []
    for line in lines:
        if joined and _is_one(joined[-1], line, noise_m):
            joined[-1] = _union(joined[-1], line)
        else:
            joined.append(line)
    if len(joined) > 4 and _is_one(joined[-1], joined[0], noise_m):
        joined = [*joined[1:-1], replace(_union(joined[-1], joined[0]), end=joined[0].end)]
    return [piece for a, b in zip(joined, [*joined[1:], joined[0]], strict=True) for piece in _with_step(a, b)]


def _union(a: Line, b: Line) -> Line:
    length = a.length + b.length
    return replace(b, offset=(a.offset * a.length + b.offset * b.length) / length, length=length)


def _with_step(a: Line, b: Line) -> list[Line]:
    """`a`, and a line square to it where `b` is parallel to it."""
    if abs(a.cosine(b)) <= PARALLEL:
        return [a]
    across = a.angle + math.copysign(math.pi / 2.0, (b.end - a.end) @ (-math.sin(a.angle), math.cos(a.angle)) or 1.0)
    return [a, Line(across, _offset(across, a.end), 0.0, a.end, a.end, True)]


def _aligned(rings: list[list[Line]], in_line_m: float) -> list[list[Line]]:
    """Faces of the building with the same direction and nearly the same offset get one offset."""
    lines = [line for ring in rings for line in ring]
    for group in _groups(lines, in_line_m):
        offset = float(np.average([lines[i].offset for i in group], weights=[lines[i].length + 1e-6 for i in group]))
        for i in group:
            lines[i] = replace(lines[i], offset=offset)
    fresh = iter(lines)
    return [list(islice(fresh, len(ring))) for ring in rings]


def _groups(lines: list[Line], in_line_m: float) -> list[list[int]]:
    """Indices of the lines along axes, in groups of one direction and offsets within `in_line_m`."""
    on_axis = [i for i, line in enumerate(lines) if line.on_axis]
    groups: list[list[int]] = []
    for i in sorted(on_axis, key=lambda i: (round(lines[i].angle % (2.0 * math.pi), 3), lines[i].offset)):
        first = lines[groups[-1][0]] if groups else None
        if first and first.cosine(lines[i]) > PARALLEL and lines[i].offset - first.offset <= in_line_m:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _corners(lines: list[Line], noise_m: float) -> Array:
    """Corners (n,2) of a ring: where neighbouring lines cross."""
    return np.array([_crossing(a, b, noise_m) for a, b in zip(lines, [*lines[1:], lines[0]], strict=True)])


def _crossing(a: Line, b: Line, noise_m: float) -> Array:
    if abs(math.sin(a.angle - b.angle)) < math.sin(BLUNT):
        return a.end
    system = np.array([(-math.sin(a.angle), math.cos(a.angle)), (-math.sin(b.angle), math.cos(b.angle))])
    point: Array = np.linalg.solve(system, (a.offset, b.offset))
    return point if math.dist(point, a.end) <= 5.0 * noise_m else a.end
