"""Compiled searches of the polygon stage (III-A.2): empty convex cycles around the robot, largest or of most floor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled


class Graph(NamedTuple):
    """Edges that cross no cut ray, sorted by source then target; sites in order of bearing from that ray."""

    points: Array  # (n,2) m
    first: Ints  # (n+1,) where the edges of each source begin
    ends: Ints  # (E,2) source and target > source
    vector: Array  # (E,3) m, m, m^2: target - source, twice the area of the triangle with the origin
    reach: Ints  # (E,) edges of the longest left-turning chain that starts with this one and crosses no cut ray
    tolerance2: float  # m^2


class Ranking(NamedTuple):
    """Of each row the largest areas among what has most vertices, best first."""

    size: Ints  # (rows,) number of vertices; 0: none
    area: Array  # (rows,keep) twice the area, m^2; -inf: none
    trace: Ints  # (rows,keep) where it came from


@compiled
def cross(ax: float, ay: float, bx: float, by: float) -> float:
    """a x b: positive when b lies counter-clockwise of a."""
    return ax * by - ay * bx


@compiled
def turns_left(ax: float, ay: float, bx: float, by: float, tolerance2: float) -> bool:
    """True when a ring that goes on by vector a, then by b, has a strict vertex between them.

    Strict: a left turn, and the vertex lies farther from the chord of its neighbours than the tolerance (squared here).
    """
    turn = ax * by - ay * bx
    cx, cy = ax + bx, ay + by
    return bool(turn > 0.0 and turn * turn > tolerance2 * (cx * cx + cy * cy))


@compiled
def order_by_bearing(points: Array) -> Ints:
    """Indices (n,) of points (n,2) by bearing in (-pi, pi] about the origin, nearest first on a ray.

    One pass if already sorted; no rounding but that of the products.
    """
    order, upper = np.empty(points.shape[0], np.int64), np.empty(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        x, y, j = points[i, 0], points[i, 1], i
        upper[i] = y > 0.0 or (y == 0.0 and x < 0.0)
        while j > 0:
            k = order[j - 1]
            turn = cross(x, y, points[k, 0], points[k, 1])
            nearer = x * x + y * y < points[k, 0] * points[k, 0] + points[k, 1] * points[k, 1]
            if not (upper[k] if upper[i] != upper[k] else turn > 0.0 or (turn == 0.0 and nearer)):
                break
            order[j] = k
            j -= 1
        order[j] = i
    return order


@compiled
def visible_edges(points: Array, tolerance: float) -> Bools:
    """Which edges i -> j (n,n) an empty polygon around the origin may have: the robot-centred form of derivations 1.2.

    The edge spans less than 180 degrees and no site in the triangle (origin, i, j), its two sides to the origin
    included, lies more than `tolerance` inside it. Points are sorted as by `order_by_bearing`.
    """
    n = points.shape[0]
    allowed, around = np.zeros((n, n), np.bool_), np.empty((2, 2 * n))  # twice around
    for i in range(2 * n):
        k = i if i < n else i - n
        around[0, i], around[1, i] = points[k, 0], points[k, 1]
    for i in range(n):
        x, y, nearest = points[i, 0], points[i, 1], i  # `nearest`: the first site on the ray of i
        while nearest > 0 and cross(points[nearest - 1, 0], points[nearest - 1, 1], x, y) == 0.0:
            if points[nearest - 1, 0] * x + points[nearest - 1, 1] * y <= 0.0:
                break
            nearest -= 1
        for j in range(i + 1, i + n):
            side, dx, dy = cross(x, y, around[0, j], around[1, j]), around[0, j] - x, around[1, j] - y
            if side < 0.0:
                break
            k, least, empty = j - 1, tolerance * tolerance * (dx * dx + dy * dy), side > 0.0
            while empty and k >= nearest:
                depth = cross(dx, dy, around[0, k] - x, around[1, k] - y)
                empty = not (depth > 0.0 and depth * depth > least)
                k -= 1
            allowed[i, j if j < n else j - n] = empty
    return allowed


@compiled
def quietest_gap(allowed: Bools) -> int:
    """The position whose ray from the origin (just before that site) is crossed by the fewest edges."""
    n = allowed.shape[0]
    change = np.zeros(n + 1, np.int64)
    for i in range(n):
        following = i + 1 if i + 1 < n else 0
        for j in range(n):
            if allowed[i, j]:
                change[following] += 1
                change[j + 1] -= 1
                change[0] += 1 if j < i and i + 1 < n else 0
    best, fewest, crossing = 0, n * n, 0
    for gap in range(n):
        crossing += change[gap]
        if crossing < fewest:
            best, fewest = gap, crossing
    return best


@compiled
def graph_of(points: Array, allowed: Bools, cut: int, tolerance: float) -> Graph:
    """The sites counted from position `cut`, with the edges that do not cross the ray before it."""
    n = points.shape[0]
    turned, first, site = np.empty((n, 2)), np.zeros(n + 1, np.int64), np.empty(n, np.int64)
    for i in range(n):
        site[i] = cut + i if cut + i < n else cut + i - n
        turned[i, 0], turned[i, 1] = points[site[i], 0], points[site[i], 1]
    ends, vector = np.empty((n * n // 2, 2), np.int64), np.empty((n * n // 2, 3))
    edges = 0
    for i in range(n):
        for j in range(i + 1, n):
            if allowed[site[i], site[j]]:
                ends[edges, 0], ends[edges, 1] = i, j
                vector[edges, 0], vector[edges, 1] = turned[j, 0] - turned[i, 0], turned[j, 1] - turned[i, 1]
                vector[edges, 2] = cross(turned[i, 0], turned[i, 1], turned[j, 0], turned[j, 1])
                edges += 1
        first[i + 1] = edges
    reach, tolerance2 = np.ones(edges, np.int64), tolerance * tolerance
    for e in range(edges - 1, -1, -1):  # edges come after those they start from
        ax, ay = vector[e, 0], vector[e, 1]
        for f in range(first[ends[e, 1]], first[ends[e, 1] + 1]):
            if reach[f] + 1 > reach[e] and turns_left(ax, ay, vector[f, 0], vector[f, 1], tolerance2):
                reach[e] = reach[f] + 1
    return Graph(turned, first, ends[:edges], vector[:edges], reach, tolerance2)


@compiled
def _rank(area: Array, trace: Ints, row: int, new_area: float, new_trace: int) -> int:
    """Ranks a candidate in a row (keep,), largest area first; its place, or -1. Equals stay in order of arrival."""
    keep = int(area.shape[1])
    place = keep
    while place > 0 and new_area > area[row, place - 1]:
        place -= 1
    if place == keep:
        return -1
    for later in range(keep - 1, place, -1):
        area[row, later], trace[row, later] = area[row, later - 1], trace[row, later - 1]
    area[row, place], trace[row, place] = new_area, new_trace
    return place


@compiled
def best_cycles(points: Array, allowed: Bools, tolerance: float, keep: int) -> tuple[Ints, Ints]:
    """Sizes (keep,) and rings (keep,n) of the convex cycles around the origin with most vertices, the largest first.

    A ring holds positions of `points`, counter-clockwise from the smallest; size 0: no cycle.
    Every cycle crosses any ray from the origin with exactly one edge. So the ray crossed by the fewest edges is taken,
    and for each edge across it the best left-turning chains that close it are found by dynamic programming over the
    others, in order of bearing: first only how long they get, then, where they get longest, by area. Count and area add
    up over the triangles (origin, i, j): exact lexicographic maxima, and of the chains that end with one edge only
    those with most vertices can matter.
    """
    n = points.shape[0]
    rings, sizes = np.full((keep, n), -1, np.int64), np.zeros(keep, np.int64)
    if n < 3:
        return sizes, rings
    cut = quietest_gap(allowed)
    graph = graph_of(points, allowed, cut, tolerance)
    edges = graph.ends.shape[0]
    chains = Ranking(np.empty(edges, np.int64), np.empty((edges, keep)), np.empty((edges, keep), np.int64))
    best = Ranking(np.zeros(1, np.int64), np.full((1, keep), -math.inf), np.zeros((1, keep), np.int64))
    lengths = np.zeros((n, n), np.int64)
    for span in range(n - 1, 1, -1):
        for head in range(n - span):
            tail = head + span
            if span + 1 >= best.size[0] and allowed[(cut + tail) % n, (cut + head) % n]:
                lengths[head, tail] = _longest(graph, tail, head, chains.size, best.size[0])
                best.size[0] = max(best.size[0], lengths[head, tail])
    for head in range(n):
        for tail in range(head, n):
            if lengths[head, tail] == best.size[0] > 0:
                _close(graph, (tail, head), chains, best, rings)
    for place in range(keep):
        if best.area[0, place] > -math.inf:
            size = sizes[place] = best.size[0]
            named = (rings[place, :size] + cut) % n
            smallest = int(np.argmin(named))
            for i in range(size):
                rings[place, i] = named[(smallest + i) % size]
    return sizes, rings


@compiled
def _longest(graph: Graph, tail: int, head: int, size: Ints, least: int) -> int:
    """Vertices of the longest cycle that closes with the edge tail -> head, 0 if it has fewer than `least`."""
    first, ends, vector, reach, tolerance2 = graph.first, graph.ends, graph.vector, graph.reach, graph.tolerance2
    cx, cy = graph.points[head, 0] - graph.points[tail, 0], graph.points[head, 1] - graph.points[tail, 1]
    longest = 0
    hopeful = False
    for e in range(first[head], first[head + 1]):
        size[e] = 2 if turns_left(cx, cy, vector[e, 0], vector[e, 1], tolerance2) else 0
        hopeful = hopeful or (size[e] == 2 and reach[e] + 1 >= least)
    if not hopeful:
        return 0
    for e in range(first[head + 1], first[tail]):
        size[e] = 0
    for e in range(first[head], first[tail]):
        middle, ax, ay, grown = ends[e, 1], vector[e, 0], vector[e, 1], size[e] + 1
        if grown == 1 or middle > tail or grown + reach[e] - 2 < least:
            continue
        if middle == tail and grown > longest + 1 and turns_left(ax, ay, cx, cy, tolerance2):
            longest = grown - 1
        for f in range(first[middle], first[middle + 1]):
            if ends[f, 1] > tail:
                break
            useful = grown > size[f] and grown + reach[f] - 1 >= least
            if useful and turns_left(ax, ay, vector[f, 0], vector[f, 1], tolerance2):
                size[f] = grown
    return longest if longest >= least else 0


@compiled
def _close(graph: Graph, closing: tuple[int, int], chains: Ranking, best: Ranking, rings: Ints) -> None:
    """Ranks the longest cycles that close with the edge tail -> head: left-turning chains of edges from head to tail.

    Each chain is handed on to the edges after its last one, unless it cannot become as long as the longest cycle.
    """
    tail, head = closing
    first, ends, vector, reach, tolerance2 = graph.first, graph.ends, graph.vector, graph.reach, graph.tolerance2
    size, area, trace, keep = chains.size, chains.area, chains.trace, rings.shape[0]
    cx, cy = graph.points[head, 0] - graph.points[tail, 0], graph.points[head, 1] - graph.points[tail, 1]
    base = cross(graph.points[tail, 0], graph.points[tail, 1], graph.points[head, 0], graph.points[head, 1])
    for e in range(first[head], first[tail]):
        size[e] = 0
    for e in range(first[head], first[tail]):
        j, ax, ay = ends[e, 1], vector[e, 0], vector[e, 1]
        if ends[e, 0] == head and turns_left(cx, cy, ax, ay, tolerance2):
            size[e], area[e] = 2, -math.inf
            _rank(area, trace, e, base + vector[e, 2], -1)
        if size[e] == 0 or j > tail or size[e] + reach[e] - 1 < best.size[0]:
            continue
        if j == tail and size[e] == best.size[0] and turns_left(ax, ay, cx, cy, tolerance2):
            _record(graph, e, chains, best, rings)
        for f in range(first[j], first[j + 1]):
            if ends[f, 1] > tail:
                break
            useful = size[e] + 1 >= size[f] and size[e] + reach[f] >= best.size[0]
            if not (useful and turns_left(ax, ay, vector[f, 0], vector[f, 1], tolerance2)):
                continue
            if size[e] + 1 > size[f]:
                size[f], area[f] = size[e] + 1, -math.inf
            slot = 0
            while slot < keep and area[e, slot] + vector[f, 2] > area[f, keep - 1]:
                _rank(area, trace, f, area[e, slot] + vector[f, 2], e * keep + slot)
                slot += 1


@compiled
def _record(graph: Graph, e: int, chains: Ranking, best: Ranking, rings: Ints) -> None:
    """Ranks the cycles closed by chains that end with edge e, and writes their vertices down, from head to tail."""
    keep, n, ends, trace = rings.shape[0], rings.shape[1], graph.ends, chains.trace
    for slot in range(keep):
        area = chains.area[e, slot]
        place = _rank(best.area, best.trace, 0, area, 0) if area > -math.inf else -1
        if place < 0:
            return
        for cell in range(keep * n - 1, (place + 1) * n - 1, -1):
            rings[cell // n, cell % n] = rings[cell // n - 1, cell % n]
        state = e * keep + slot
        for position in range(chains.size[e] - 1, 0, -1):
            rings[place, position] = ends[state // keep, 1]
            rings[place, 0] = ends[state // keep, 0]
            state = trace[state // keep, state % keep]


@compiled
def largest_cycle(points: Array, allowed: Bools, tolerance: float) -> tuple[Ints, Ints]:
    """Size (1,) and ring (1,n) of the convex cycle around the origin with the largest area; size 0: no cycle.

    Input and rings are those of `best_cycles`, and so is the dynamic programme: the edge that crosses the quietest ray
    closes the cycle, and the area adds up over the triangles (origin, i, j). Here the chains that end with one edge are
    ranked by area alone, whatever their number of vertices: of those only the largest can matter. A chain is given up
    where even the largest continuation of its last edge does not exceed the best cycle so far. Exact.
    """
    n = points.shape[0]
    sizes, rings, best = np.zeros(1, np.int64), np.full((1, n), -1, np.int64), 0.0
    if n < 3:
        return sizes, rings
    cut = quietest_gap(allowed)
    graph = graph_of(points, allowed, cut, tolerance)
    edges = graph.ends.shape[0]
    gain, area, trace = np.zeros(edges), np.empty(edges), np.empty(edges, np.int64)
    for e in range(edges - 1, -1, -1):  # what the largest chain after an edge adds; edges come after their sources'
        for f in range(graph.first[graph.ends[e, 1]], graph.first[graph.ends[e, 1] + 1]):
            more = graph.vector[f, 2] + gain[f]
            ax, ay, bx, by = graph.vector[e, 0], graph.vector[e, 1], graph.vector[f, 0], graph.vector[f, 1]
            if more > gain[e] and turns_left(ax, ay, bx, by, graph.tolerance2):
                gain[e] = more
    for head in range(n):
        for tail in range(head + 2, n):
            if not allowed[(cut + tail) % n, (cut + head) % n]:
                continue
            last, most = _largest_chain(graph, (tail, head), gain, (area, trace), best)
            if last >= 0:
                best, size, e = most, 0, last
                while e >= 0:
                    rings[0, size], size, e = graph.ends[e, 1], size + 1, trace[e]
                rings[0, size] = head
                sizes[0] = size + 1
    size = sizes[0]
    if size > 0:
        clockwise = (rings[0, :size] + cut) % n
        smallest = int(np.argmin(clockwise))
        for i in range(size):
            rings[0, i] = clockwise[(smallest - i) % size]
    return sizes, rings


@compiled
def _largest_chain(
    graph: Graph, closing: tuple[int, int], gain: Array, chains: tuple[Array, Ints], least: float
) -> tuple[int, float]:
    """Last edge and twice the area of the largest cycle above `least` that closes with tail -> head; -1: there is none.

    `chains` are written: twice the area of the largest chain from the head that ends with each edge, and the edge
    before it, -1 for the first one. `gain` (E,) is what each edge's continuation adds at most.
    """
    (tail, head), (area, trace) = closing, chains
    first, ends, vector, tolerance2 = graph.first, graph.ends, graph.vector, graph.tolerance2
    cx, cy = graph.points[head, 0] - graph.points[tail, 0], graph.points[head, 1] - graph.points[tail, 1]
    base = cross(graph.points[tail, 0], graph.points[tail, 1], graph.points[head, 0], graph.points[head, 1])
    last, most = -1, least
    for e in range(first[head], first[tail]):
        area[e] = -math.inf
    for e in range(first[head], first[tail]):
        j, ax, ay = ends[e, 1], vector[e, 0], vector[e, 1]
        if ends[e, 0] == head and turns_left(cx, cy, ax, ay, tolerance2):
            area[e], trace[e] = base + vector[e, 2], -1
        if j > tail or area[e] + gain[e] <= most:
            continue
        if j == tail and area[e] > most and turns_left(ax, ay, cx, cy, tolerance2):
            last, most = e, area[e]
        for f in range(first[j], first[j + 1]):
            if ends[f, 1] > tail:
                break
            grown = area[e] + vector[f, 2]
            if grown > area[f] and turns_left(ax, ay, vector[f, 0], vector[f, 1], tolerance2):
                area[f], trace[f] = grown, e
    return last, most
