"""Plain images: bright pixels are floor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mecp_env.core.errors import LayoutError
from mecp_env.core.paths import exists
from mecp_env.floorplans.files import grey, read_image
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import Placement, floor_polygon


def read_plain_image(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of an image whose pixels have `options.resolution_m`, brighter than `options.free_above`."""
    if options.resolution_m is None:
        sheet = path.with_suffix(".yaml")
        beside = f" ({sheet.name} lies beside it)" if exists(sheet) else ""
        raise LayoutError(f"resolution_m: missing, metres per pixel; give it, or name a map_server yaml{beside}")
    levels, opaque = grey(read_image(path))
    threshold = otsu(levels) if options.free_above is None else options.free_above
    placement = Placement(options.resolution_m)
    area = floor_polygon((levels > threshold) & opaque, placement)
    note = f"From {path.name}: {options.resolution_m:g} m per pixel, floor where brighter than {threshold}."
    return FreeSpace(path.stem, note, area, placement.noise_m)


def otsu(levels: NDArray[np.uint8]) -> int:
    """The grey level that separates dark from bright best (Otsu 1979): greatest variance between both."""
    counts = np.array(Image.fromarray(levels).histogram(), np.float64)
    below = np.cumsum(counts)
    sums = np.cumsum(counts * np.arange(256))
    above = below[-1] - below
    with np.errstate(invalid="ignore", divide="ignore"):
        between = below * above * (sums / below - (sums[-1] - sums) / above) ** 2
    if not np.isfinite(between).any():
        raise LayoutError("image: all its pixels have one grey level")
    return int(np.nanargmax(between))
