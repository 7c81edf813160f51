"""Layouts and believed maps for other programs: map_server pairs and SVG."""

from __future__ import annotations

import colorsys
import math
import os
from collections.abc import Iterator
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mecp_env.core.errors import LayoutError
from mecp_env.core.files import sanitised
from mecp_env.slam.export import Level, save_grid, save_levels
from mecp_env.slam.messages import Cell, SemanticGrid
from mecp_env.world.layout import Layout
from mecp_env.world.outline import Outline, build_outline, door_ring, thin_walls_m

FREE, OCCUPIED, UNKNOWN = int(Level.FREE), int(Level.OCCUPIED), int(Level.UNKNOWN)
WALL_M = 0.15  # so much of what bounds the floor is drawn as wall; behind it nothing is known
THIN = 0.95  # of a pixel: a thinner wall would have holes
MAX_PIXELS = 4096 * 4096


def save_map_server(
    given: Layout | SemanticGrid, stem: str | os.PathLike[str], resolution_m: float = 0.05
) -> tuple[Path, Path]:
    """Write `stem`.yaml and `stem`.pgm for the map_server of ROS; the two paths.

    A layout is drawn with pixels of `resolution_m`; a grid keeps its own. Raises LayoutError for more than 4096 x 4096
    pixels, for walls thinner than a pixel, and OSError where the files cannot be written.
    """
    stem = Path(stem)
    sheet, image = (stem.with_name(stem.name + ending) for ending in (".yaml", ".pgm"))
    if isinstance(given, Layout):
        save_levels(*_raster(build_outline(given), resolution_m), resolution_m, sheet)
    else:
        save_grid(given, sheet)
    return sheet, image


def _raster(outline: Outline, resolution_m: float) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Levels (h,w), row 0 at the bottom, of the floor and the walls around it; where its lower left corner lies."""
    if not 0.005 <= resolution_m <= 1.0:
        raise LayoutError(f"resolution_m: from 0.005 to 1 m (given: {resolution_m!r:.80})")
    thin_m = thin_walls_m(outline.free_area, THIN * resolution_m)
    if thin_m > 0.0:
        raise LayoutError(f"resolution_m: {thin_m:.1f} m of walls are thinner than a pixel of {resolution_m:g} m")
    wall = max(WALL_M, 1.5 * resolution_m)
    x0, y0, x1, y1 = outline.free_area.buffer(wall + resolution_m).bounds
    width, height = math.ceil((x1 - x0) / resolution_m), math.ceil((y1 - y0) / resolution_m)
    if width * height > MAX_PIXELS:
        raise LayoutError(f"resolution_m: {width} x {height} pixels at {resolution_m:g} m, at most {MAX_PIXELS} in all")
    x, y = (np.arange(width) + 0.5) * resolution_m + x0, (np.arange(height) + 0.5) * resolution_m + y0
    solid = outline.free_area.buffer(wall, join_style="mitre")
    levels = np.full((height, width), UNKNOWN, dtype=np.uint8)
    levels[_covered(Polygon(solid.exterior), x, y)] = OCCUPIED
    levels[_covered(outline.free_area, x, y)] = FREE
    return levels, np.array([x0, y0])


def _covered(area: Polygon, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (h,w) of a lattice, x and y ascending, lie in `area`: those with an odd number of edges before."""
    crossings = np.zeros((len(y), len(x) + 1), dtype=np.int32)
    for ring in (area.exterior, *area.interiors):
        for (x0, y0), (x1, y1) in pairwise(ring.coords):
            first, last = np.searchsorted(y, sorted((y0, y1)))
            across = x0 + (y[first:last] - y0) / ((y1 - y0) or 1.0) * (x1 - x0)
            crossings[np.arange(first, last), np.searchsorted(x, across)] += 1
    covered: NDArray[np.bool_] = np.cumsum(crossings[:, :-1], axis=1) % 2 == 1
    return covered


def save_svg(given: Layout | SemanticGrid, path: str | os.PathLike[str]) -> Path:
    """Write a drawing with the rooms in colours and the doors marked, one unit a metre; its path."""
    if isinstance(given, Layout):
        outline = build_outline(given)
        bounds, shapes = outline.bounds, list(_of_layout(outline))
    else:
        height, width = given.label.shape
        (x, y), side = given.origin.tolist(), given.resolution_m
        bounds, shapes = (x, y, x + side * width, y + side * height), list(_of_grid(given))
    path = Path(path)
    path.write_text(_page(bounds, shapes), encoding="utf-8")
    return path


def _page(bounds: tuple[float, float, float, float], shapes: list[str]) -> str:
    x0, y0, x1, y1 = bounds
    box = f"{x0 - 0.5:.3f} {-y1 - 0.5:.3f} {x1 - x0 + 1.0:.3f} {y1 - y0 + 1.0:.3f}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="{20.0 * (x1 - x0 + 1.0):.0f}">'
    return "\n".join([head, f'<g transform="scale(1 -1)">{"".join(shapes)}</g>', "</svg>", ""])


def _of_layout(outline: Outline) -> Iterator[str]:
    for index, (name, room) in enumerate(zip(outline.room_names, outline.rooms, strict=True)):
        yield _path(room.intersection(outline.free_area), _colour(index), name)
    for index in range(len(outline.doors)):
        pair = " and ".join(outline.room_names[room] for room in outline.doors.rooms[index].tolist())
        yield _path(Polygon(door_ring(outline.doors, index, 0.0)), "#d33", f"door of {pair}")
    edge = _outline_path(outline.free_area)
    yield f'<path d="{edge}" fill="none" stroke="#222" stroke-width="0.06" stroke-linejoin="round"/>\n'


def _of_grid(grid: SemanticGrid) -> Iterator[str]:
    """Rectangles of the runs of equal cells of each row."""
    colour = np.where(grid.label == int(Cell.FREE), grid.room.astype(np.int64) + 1, -1)
    colour[grid.label == int(Cell.OCCUPIED)] = -2
    colour[grid.label == int(Cell.DOOR)] = -3
    for row, values in enumerate(colour):
        ends = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
        yield from (_run(grid, row, run, int(values[run[0]])) for run in pairwise(ends) if values[run[0]] != -1)


def _run(grid: SemanticGrid, row: int, columns: tuple[int, int], value: int) -> str:
    side, (x, y) = grid.resolution_m, grid.origin.tolist()
    fill = {-2: "#222", -3: "#d33", 0: "#ddd"}.get(value) or _colour(value - 1)
    place = f'x="{x + side * columns[0]:.3f}" y="{y + side * row:.3f}"'
    return f'<rect {place} width="{side * (columns[1] - columns[0]):.3f}" height="{side:.3f}" fill="{fill}"/>\n'


def _colour(index: int) -> str:
    """A pale colour; neighbours in number are far apart in hue."""
    red, green, blue = colorsys.hls_to_rgb((0.61803 * index) % 1.0, 0.82, 0.6)
    return f"#{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"


def _path(area: BaseGeometry, fill: str, title: str) -> str:
    parts = [part for part in shapely.get_parts(area) if isinstance(part, Polygon)]
    edge = " ".join(map(_outline_path, parts))
    return f'<path d="{edge}" fill="{fill}" fill-rule="evenodd"><title>{escape(sanitised(title))}</title></path>\n'


def _outline_path(area: Polygon) -> str:
    rings = [np.array(ring.coords)[:-1].tolist() for ring in (area.exterior, *area.interiors)]
    return " ".join("M" + " L".join(f"{x:.3f} {y:.3f}" for x, y in ring) + " Z" for ring in rings)
