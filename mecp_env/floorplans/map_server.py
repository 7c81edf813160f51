"""Maps of the ROS map_server: a yaml file with resolution, origin and thresholds, and an image beside it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from pydantic import BeforeValidator, ConfigDict, Field, Strict, model_validator

from mecp_env.core.array_types import Bools
from mecp_env.core.errors import LayoutError
from mecp_env.core.paths import read_bytes
from mecp_env.core.settings import shown
from mecp_env.floorplans.image import grey, read_image
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import Placement, floor_polygon
from mecp_env.world.schema import Document

MAX_YAML_BYTES = 20_000
HALF = 50  # percent: in the modes scale and raw a cell less likely to be occupied is floor

Offset = Annotated[float, Strict(), Field(ge=-900.0, le=900.0)]
Yaw = Annotated[float, Strict(), Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]


def _with_yaw(origin: Any) -> Any:
    return [*origin, 0.0] if isinstance(origin, list) and len(origin) == 2 else origin


class Sheet(Document):
    """The fields of a yaml file that are used."""

    model_config = ConfigDict(extra="ignore")

    image: Annotated[str, Field(min_length=1, max_length=500)]
    resolution: Annotated[float, Strict(), Field(ge=0.005, le=1.0)]  # m per pixel
    origin: Annotated[tuple[Offset, Offset, Yaw], BeforeValidator(_with_yaw)]  # m, rad, of the lower left pixel
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: bool = False
    free_thresh: Share = 0.196
    occupied_thresh: Share = 0.65

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(
                f"free_thresh: {self.free_thresh:g} is not below occupied_thresh, {self.occupied_thresh:g}"
            )
        return self

    def floor_levels(self) -> Bools:
        """Which grey levels (256,) are floor; what is unknown is not."""
        level = np.arange(256)[::-1] if self.negate else np.arange(256)
        if self.mode == "raw":
            return level < HALF  # percent occupied; 255 is unknown
        occupied, low, high = (255 - level) / 255.0, self.free_thresh, self.occupied_thresh
        return occupied < low if self.mode == "trinary" else 1.0 + 98.0 * (occupied - low) / (high - low) < HALF


def read_map_server(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of the map that a yaml file describes; of `options` only what shapes the rooms is used."""
    sheet = _sheet(path)
    x, y, yaw = sheet.origin
    placement = Placement(sheet.resolution, (x, y), yaw)
    image = _beside(path, sheet.image)
    levels, opaque = grey(read_image(image))
    area = floor_polygon(sheet.floor_levels()[levels] & opaque, placement)
    note = f"From {path.name} and {image.name}: {sheet.resolution:g} m per pixel."
    return FreeSpace(path.stem, note, area, placement.noise_m)


def image_of(path: Path) -> Path | None:
    """The image that a yaml file names, with all links followed; None where it names none that may be read."""
    try:
        return _beside(path, _sheet(path).image)
    except LayoutError:
        return None


class OnceLoader(yaml.SafeLoader):
    """Plain data in which no field is given twice: YAML forbids it, and PyYAML would keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """The mapping of a node. Raises LayoutError."""
        counts = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        for name, count in counts.items():
            if count > 1:
                raise LayoutError(f"{name:.80}: given {'twice' if count == 2 else f'{count} times'}")
        return super().construct_mapping(node, deep)


def _sheet(path: Path) -> Sheet:
    """The checked fields of a yaml file."""
    data = read_bytes(path, MAX_YAML_BYTES)
    try:
        fields = yaml.load(data.decode("utf-8"), OnceLoader)
    except LayoutError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise LayoutError(f"no yaml: {' '.join(str(error).split()):.160}") from None
    if not isinstance(fields, dict):
        raise LayoutError(f"a mapping with image, resolution and origin expected, given {type(fields).__name__}")
    return Sheet(**{str(name): value for name, value in fields.items()})


def _beside(path: Path, given: str) -> Path:
    """The image file, which must lie in the folder of the yaml file or below."""
    try:
        folder = path.parent.resolve()
        image = (folder / given).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise LayoutError(f"image: {shown(given)} cannot be found ({error})") from None
    if not image.is_relative_to(folder):
        raise LayoutError(f"image: {shown(given)} leaves the folder of the yaml file")
    return image
