"""Maps of the ROS map_server: a yaml file with resolution, origin and thresholds, and an image beside it."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from mecp_env.core.errors import LayoutError
from mecp_env.core.paths import read_bytes
from mecp_env.core.settings import shown
from mecp_env.floorplans.files import grey, read_image, require
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import Placement, floor_polygon

MAX_YAML_BYTES = 20_000
MAX_PARTS = 500
MAX_YAML_DEPTH = 4
MODES = ("trinary", "scale", "raw")
REQUIRED = ("image", "resolution", "origin")
HALF = 50  # percent: in the modes scale and raw a cell less likely to be occupied is floor


def read_map_server(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of the map that a yaml file describes; of `options` only what shapes the rooms is used."""
    fields = _fields(read_bytes(path, MAX_YAML_BYTES))
    resolution = require(fields["resolution"], "resolution", 0.005, 1.0)
    placement = _placement(fields["origin"], resolution)
    floor = _floor_levels(fields)
    image = _beside(path, fields["image"])
    levels, opaque = grey(_decoded(image, fields["image"]))
    free = floor[levels] if opaque is None else floor[levels] & opaque
    note = f"From {path.name} and {image.name}: {resolution:g} m per pixel."
    return FreeSpace(path.stem, note, floor_polygon(free, placement), placement.noise_m)


def image_of(path: Path) -> Path | None:
    """The image that a yaml file names, with all links followed; None where it names none that may be read."""
    try:
        return _beside(path, _fields(read_bytes(path, MAX_YAML_BYTES))["image"])
    except LayoutError:
        return None


def _fields(data: bytes) -> dict[str, Any]:
    """The fields of the yaml file. Raises LayoutError for tags, anchors, aliases, and what is no flat mapping."""
    try:
        fields = yaml.load(data.decode("utf-8"), Loader=_PlainLoader)  # a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, LayoutError):
            raise
        raise LayoutError(f"no yaml: {' '.join(str(error).split())[:160]}") from None
    if not isinstance(fields, dict):
        raise LayoutError(f"a mapping with {', '.join(REQUIRED)} expected, given {type(fields).__name__}")
    missing = [key for key in REQUIRED if key not in fields]
    if missing:
        raise LayoutError(f"{missing[0]}: missing")
    return fields


class _PlainLoader(yaml.SafeLoader):
    """A loader that refuses tags, anchors, aliases, deep nesting, and a key that a mapping has twice."""

    depth = parts = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        tag = getattr(event, "tag", None)
        self.depth, self.parts = self.depth + 1, self.parts + 1
        if isinstance(event, yaml.events.AliasEvent) or event.anchor:
            raise LayoutError("yaml with anchors or aliases is refused")
        if tag:
            raise LayoutError(f"yaml with tags is refused (given: {shown(tag)})")
        if self.depth - isinstance(event, yaml.ScalarEvent) > MAX_YAML_DEPTH or self.parts > MAX_PARTS:
            raise LayoutError(f"yaml is nested deeper than {MAX_YAML_DEPTH} or has more than {MAX_PARTS} parts")
        node = super().compose_node(parent, index)
        self.depth -= 1
        if isinstance(node, yaml.MappingNode):
            self._require_unique_keys(node)
        return node

    def _require_unique_keys(self, node: yaml.MappingNode) -> None:
        keys = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        for key, count in keys.items():
            if count > 1:
                raise LayoutError(f"{key:.80}: given {'twice' if count == 2 else f'{count} times'}")


def _placement(origin: Any, resolution: float) -> Placement:
    if not isinstance(origin, list) or len(origin) not in (2, 3):
        raise LayoutError(f"origin: x, y and yaw expected (given: {shown(origin)})")
    x, y = (require(value, f"origin.{i}", -900.0, 900.0) for i, value in enumerate(origin[:2]))
    yaw = require(origin[2], "origin.2", -2.0 * math.pi, 2.0 * math.pi) if len(origin) == 3 else 0.0
    return Placement(resolution, (x, y), yaw)


def _beside(path: Path, given: Any) -> Path:
    """The image file, which must lie in the folder of the yaml file or below."""
    if not isinstance(given, str) or not 0 < len(given) < 500 or "\0" in given:
        raise LayoutError(f"image: the name of a file expected (given: {shown(given)})")
    try:
        folder = path.parent.resolve()
        image = (folder / given).resolve()
    except (OSError, RuntimeError) as error:
        raise LayoutError(f"image: {shown(given)} cannot be found ({error})") from None
    if not image.is_relative_to(folder):
        raise LayoutError(f"image: {shown(given)} leaves the folder of the yaml file")
    return image


def _decoded(image: Path, given: str) -> Image.Image:
    """The image of the field `image`, which every error names with what it says."""
    try:
        return read_image(image)
    except LayoutError as error:
        raise LayoutError(f"image: {shown(given)}: {str(error).removeprefix('image: ')}") from None


def _floor_levels(fields: dict[str, Any]) -> NDArray[np.bool_]:
    """Which grey levels (256,) are floor; what is unknown is not."""
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise LayoutError(f"mode: one of {', '.join(MODES)} expected (given: {shown(mode)})")
    if fields.get("negate", 0) not in (0, 1):
        raise LayoutError(f"negate: 0 or 1 expected (given: {shown(fields['negate'])})")
    low = require(fields.get("free_thresh", 0.196), "free_thresh", 0.0, 1.0)
    high = require(fields.get("occupied_thresh", 0.65), "occupied_thresh", 0.0, 1.0)
    if low >= high:
        raise LayoutError(f"free_thresh: {low:g} is not below occupied_thresh, {high:g}")
    return _table(mode, bool(fields.get("negate", 0)), low, high)


def _table(mode: str, negate: bool, low: float, high: float) -> NDArray[np.bool_]:
    """Which grey levels (256,) are floor."""
    level = np.arange(256)[::-1] if negate else np.arange(256)
    if mode == "raw":
        return level < HALF  # percent occupied; 255 is unknown
    occupied = (255 - level) / 255.0
    return occupied < low if mode == "trinary" else 1.0 + 98.0 * (occupied - low) / (high - low) < HALF
