"""Rooms of an imported floor plan against labels, the true room number of each pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from mecp_env.core.carriers import Array
from mecp_env.floorplans import load_plan
from mecp_env.world.schema import Layout

PIXEL_M = 0.05  # of the labels
LEAST_M2 = 2.0  # smaller labelled rooms need not be found
MATCH = 0.5  # IoU above which an imported room is a labelled one; no room can then match two


def score_plan(path: Path) -> dict[str, int]:
    """The score of a plan that has an image with labels beside it."""
    labels = np.asarray(Image.open(path.with_suffix(".rooms.png")), np.int32)
    return score_rooms(load_plan(path), labels, PIXEL_M)


def room_pixels(layout: Layout, shape: tuple[int, int], resolution_m: float) -> NDArray[np.int32]:
    """Number (h,w) of the room at each pixel, from 1, 0 elsewhere; row 0 at the top, the origin below left."""
    image = Image.new("I", shape[::-1])
    draw = ImageDraw.Draw(image)
    for number, room in enumerate(layout.rooms, 1):
        corners = np.array(room.polygon) / resolution_m * (1.0, -1.0) + (-0.5, shape[0] - 0.5)
        draw.polygon([tuple(corner) for corner in corners.tolist()], fill=number)
    return np.asarray(image, np.int32)


def overlaps(found: NDArray[np.int32], labels: NDArray[np.int32]) -> Array:
    """IoU (f+1,l+1) of every room of `found` with every label, each (h,w); row and column 0 are no rooms."""
    numbers = [np.arange(int(image.max()) + 2) for image in (found, labels)]
    shared = np.histogram2d(found.ravel(), labels.ravel(), numbers)[0]
    union = shared.sum(axis=1)[:, None] + shared.sum(axis=0) - shared
    iou: Array = shared / np.maximum(union, 1.0)
    iou[0], iou[:, 0] = 0.0, 0.0
    return iou


def score_rooms(layout: Layout, labels: NDArray[np.int32], resolution_m: float) -> dict[str, int]:
    """How many labelled rooms of at least `LEAST_M2` there are and how many are found; rooms that match no label.

    `labels` (h,w) are of pixels with a side of `resolution_m`.
    """
    pixels = room_pixels(layout, labels.shape, resolution_m)
    matches = np.greater(overlaps(pixels, labels), MATCH)
    sizes = np.bincount(labels.ravel(), minlength=matches.shape[1]) * resolution_m**2
    large = (sizes >= LEAST_M2) & (np.arange(len(sizes)) > 0)
    return {
        "labelled": int(large.sum()),
        "found": int(matches.any(axis=0)[large].sum()),
        "imported": len(layout.rooms),
        "false": len(layout.rooms) - int(matches.any(axis=1).sum()),
    }
