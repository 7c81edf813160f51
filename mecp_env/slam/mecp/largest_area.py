"""Compiled search of the structure `largest_area`: the empty convex cycle around the origin that covers most floor."""

from __future__ import annotations

import math

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.jit import compiled
from mecp_env.slam.mecp.cycles import Graph, cross, graph_of, quietest_gap, turns_left


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
