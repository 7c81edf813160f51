"""Labelled images: black is wall, white a closed door, every other colour a room."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage
from shapely.geometry import Point

from mecp_env.core.carriers import Array
from mecp_env.core.errors import LayoutError
from mecp_env.floorplans.image import read_image
from mecp_env.floorplans.options import Crossing, FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import MAX_CELLS, Placement, floor_polygon

MAX_PARTS = 2_000  # rooms, or doors, of an image
MAX_SPREAD = 20_000_000  # pixels in the boxes around each colour
SMALLEST_CELLS = 12  # a patch of fewer pixels is the blurred edge of another

OPAQUE, BLACK, WHITE = 0xFF000000, 0xFF000000, 0xFFFFFFFF
Labels = NDArray[np.int32]
DOWNWARDS = np.array([1.0, -1.0])  # rows are counted from above
WALL, DOOR = 0, 1  # rooms are 2, 3, ...


def read_labelled_image(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of a labelled image, its rooms, and its doors: white patches that part two rooms.

    Raises LayoutError where two rooms touch without a door, and for a door that does not join two rooms.
    """
    if options.resolution_m is None:
        raise LayoutError("resolution_m: missing, metres per pixel")
    image = read_image(path)
    if image.width * image.height > MAX_CELLS:
        raise LayoutError(f"image: {image.width} x {image.height} pixels, at most {MAX_CELLS} with labels")
    labels = _labels(image)
    _check_closed(labels)
    placement = Placement(options.resolution_m)
    area = floor_polygon(labels != WALL, placement, told=True)  # every room is required
    note = f"From {path.name}, labelled: {options.resolution_m:g} m per pixel."
    crossings, drawn = _crossings(labels, placement), _drawn(labels, placement)
    return FreeSpace(path.stem, note, area, placement.noise_m, crossings=crossings, drawn=drawn)


def _labels(image: Image.Image) -> Labels:
    """The label (h,w) of each pixel; patches of one colour that do not touch are two rooms."""
    image = image.convert("RGBA")
    if image.getcolors(MAX_PARTS) is None:
        raise LayoutError(f"image: more than {MAX_PARTS} colours; save it without blur or compression")
    colour = np.array(image).view("<u4")[..., 0]  # red in the lowest byte, opacity in the highest
    colour[colour < OPAQUE] = BLACK
    values, index = np.unique(colour, return_inverse=True)
    labels = np.where(colour == WHITE, DOOR, WALL).astype(np.int32)
    is_room = (values != BLACK) & (values != WHITE)
    codes = np.where(is_room, np.arange(1, len(values) + 1), 0).astype(np.int32)[index.reshape(colour.shape)]
    places = [(code, place) for code, place in enumerate(ndimage.find_objects(codes), 1) if place is not None]
    if sum(labels[place].size for _, place in places) > MAX_SPREAD:
        raise LayoutError(f"image: {len(places)} colours overlap; save it without blur or compression")
    last = DOOR
    for code, place in places:
        last = _number_patches(labels[place], codes[place] == code, last)
    return labels


def _number_patches(labels: Labels, here: NDArray[np.bool_], last: int) -> int:
    """The last number given: each patch of `here` (h,w) gets one above `last`, in place; small patches stay walls."""
    patches, _ = ndimage.label(here)
    sizes = np.bincount(patches.ravel())
    sizes[0] = 0
    large = sizes >= SMALLEST_CELLS
    if last + large.sum() > MAX_PARTS:
        raise LayoutError(f"image: more than {MAX_PARTS} rooms")
    number = np.where(large, last + np.cumsum(large), WALL)
    labels[here] = number[patches[here]]
    return int(last + large.sum())


def _check_closed(labels: Labels) -> None:
    """Rooms touch no other room."""
    for first, second in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        open_edge = (first > DOOR) & (second > DOOR) & (first != second)
        if open_edge.any():
            row, column = np.argwhere(open_edge)[0].tolist()
            raise LayoutError(f"image: two rooms touch at column {column}, row {row}; close them by a white door line")


def _crossings(labels: Labels, placement: Placement) -> tuple[Crossing, ...]:
    doors, count = ndimage.label(labels == DOOR, structure=np.ones((3, 3)))
    if count > MAX_PARTS:
        raise LayoutError(f"image: {count} doors, at most {MAX_PARTS}")
    found: list[Any] = [_crossing(labels, doors, i, place) for i, place in enumerate(ndimage.find_objects(doors), 1)]
    return tuple(Crossing(_in_world(middle[None], labels, placement)[0], along * DOWNWARDS) for middle, along in found)


def _in_world(pixels: Array, labels: Labels, placement: Placement) -> Array:
    """Points (n,2), m, of the middles of pixels (n,2), column and row from above."""
    return placement.to_world(pixels * DOWNWARDS + (0.5, len(labels) - 0.5))


def _drawn(labels: Labels, placement: Placement) -> tuple[tuple[str, Point], ...]:
    """Each room: the pixel that is furthest from its edges, and the point there."""
    inside = np.pad(labels > DOOR, 1)
    depth = ndimage.distance_transform_cdt(inside, "chessboard")[1:-1, 1:-1]
    deepest = np.zeros(int(labels.max()) + 1, np.int32)
    np.maximum.at(deepest, labels, depth)
    rows, columns = np.nonzero((depth > 0) & (depth == deepest[labels]))
    _, first = np.unique(labels[rows, columns], return_index=True)
    pixels = np.stack([columns[first], rows[first]], axis=1)
    points = shapely.points(_in_world(pixels.astype(np.float64), labels, placement))
    return tuple((f"column {x}, row {y}", point) for (x, y), point in zip(pixels.tolist(), points, strict=True))


def _crossing(labels: Labels, doors: Any, index: int, place: Any) -> tuple[Any, Any]:
    """Middle and direction, column and row, of a door: along the edges that it shares with its two rooms."""
    top, left = max(place[0].start - 1, 0), max(place[1].start - 1, 0)
    window = np.s_[top : place[0].stop + 1, left : place[1].stop + 1]
    beside = ndimage.binary_dilation(doors[window] == index, np.ones((3, 3), dtype=np.bool_)) & (labels[window] > DOOR)
    rooms = np.unique(labels[window][beside])
    if len(rooms) != 2:
        raise LayoutError(f"image: the door at column {left + 1}, row {top + 1} joins {len(rooms)} rooms, 2 expected")
    edges = [np.argwhere(beside & (labels[window] == room))[:, ::-1].astype(np.float64) for room in rooms]
    spread = np.concatenate([edge - edge.mean(axis=0) for edge in edges])
    along = np.linalg.eigh(spread.T @ spread)[1][:, -1]
    return (edges[0].mean(axis=0) + edges[1].mean(axis=0)) / 2.0 + (left, top), along
