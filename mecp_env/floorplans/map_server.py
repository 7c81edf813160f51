"""Maps of the ROS map_server: a yaml file with resolution, origin and thresholds, and an image beside it."""

from __future__ import annotations

import math
import re
import warnings
from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, Field, Strict, model_validator

from mecp_env.core.carriers import Array, Bools
from mecp_env.core.errors import LayoutError, PlanWarning
from mecp_env.core.files import exists, read_bytes, text_of
from mecp_env.core.settings import guess, shown
from mecp_env.floorplans.foreign import of_yaml
from mecp_env.floorplans.image import UNKNOWN_SHARE, grey, read_image, shares
from mecp_env.floorplans.options import FreeSpace, PlanOptions
from mecp_env.floorplans.vectorise import Placement, floor_polygon
from mecp_env.world.schema import Document

MAX_YAML_BYTES = 20_000
SAVED_UNKNOWN, SAVED_FREE = 205, 254  # grey levels that every map_saver writes in the mode trinary, beside 0
SAVED_SHARE = 0.999  # of a picture without free cells has the marks of a map_saver
NEAR_WHITE = 230  # a level from here on is free without a doubt
WITHOUT_POINT = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+")  # a number that PyYAML does not know
HALF = 50  # percent: in the modes scale and raw a cell less likely to be occupied is floor
EXPECTED = (
    "expected as of map_server: resolution in m per pixel, origin [x, y, yaw] in m (within 900; for a plan, 0 will do) "
    "and rad, thresholds as shares from 0 to 1"
)

Offset = Annotated[float, Strict(), Field(ge=-900.0, le=900.0)]
Yaw = Annotated[float, Strict(), Field(ge=-2.0 * math.pi, le=2.0 * math.pi)]
Share = Annotated[float, Strict(), Field(ge=0.0, le=1.0)]


def _with_yaw(origin: Any) -> Any:
    return [*origin, 0.0] if isinstance(origin, list) and len(origin) == 2 else origin


def _lower(mode: Any) -> Any:
    return mode.lower() if isinstance(mode, str) else mode


class Sheet(Document):
    """The fields of a yaml file that are used."""

    model_config = ConfigDict(extra="ignore")

    image: Annotated[str, Field(min_length=1, max_length=500)]
    resolution: Annotated[float, Strict(), Field(ge=0.005, le=1.0)]  # m per pixel
    origin: Annotated[tuple[Offset, Offset, Yaw], BeforeValidator(_with_yaw)]  # m, rad, of the lower left pixel
    mode: Annotated[Literal["trinary", "scale", "raw"], BeforeValidator(_lower)] = "trinary"  # in any case, as in nav2
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
            return np.arange(256) < HALF  # percent occupied, whatever `negate` is, as in nav2; 255 is unknown
        occupied, low, high = (255 - level) / 255.0, self.free_thresh, self.occupied_thresh
        return occupied < low if self.mode == "trinary" else 1.0 + 98.0 * (occupied - low) / (high - low) < HALF

    def dark_levels(self) -> Bools:
        """Which grey levels (256,) are not near white, and so no floor without a doubt; in the mode raw none is."""
        level = np.arange(256)[::-1] if self.negate else np.arange(256)
        return (level < NEAR_WHITE) & (self.mode != "raw")


def read_map_server(path: Path, options: PlanOptions) -> FreeSpace:
    """The floor of the map that a yaml file describes; of `options` only what shapes the rooms is used."""
    sheet = _sheet(path)
    x, y, yaw = sheet.origin
    placement = Placement(sheet.resolution, (x, y), yaw)
    image = _beside(path, sheet.image)
    _tell_moved(path, sheet.image, image)
    levels, opaque = grey(read_image(image))
    floor = _free(sheet, levels, opaque, path.name)[levels]
    floor &= opaque
    del levels, opaque  # of large images
    area = floor_polygon(floor, placement)
    note = f"From {path.name} and {image.name}: {sheet.resolution:g} m per pixel."
    return FreeSpace(path.stem, note, area, placement.noise_m)


def _free(sheet: Sheet, levels: NDArray[np.uint8], opaque: Bools, name: str) -> Bools:
    """Which grey levels (256,) are floor in a picture; warns of one that is not near white and might be unknown.

    The mark of unknown cells of a map_saver is unknown, also where `free_thresh` would make it free, as the one of nav2
    does, which saves 205 and 0.25.
    """
    free, share = sheet.floor_levels(), shares(levels, opaque)
    doubts = _odd_modes(sheet, share)
    if free[SAVED_UNKNOWN] and share[SAVED_UNKNOWN] > 0.0 and _is_saved(sheet, share):
        free[SAVED_UNKNOWN] = False
        said = f"is read as unknown, as map_saver means it, although free_thresh {sheet.free_thresh:g} makes it free"
        doubts.append(f"grey {SAVED_UNKNOWN} {said}")
    said = "of the picture is not near white and counts as free; free_thresh decides"
    doubtful = np.flatnonzero(free & sheet.dark_levels() & (share >= UNKNOWN_SHARE)).tolist()
    doubts += [f"grey {level} on {100.0 * share[level]:.0f} % {said}" for level in doubtful]
    for doubt in doubts:
        warnings.warn(f"{name!r:.80}: {doubt}", PlanWarning, stacklevel=4)
    return free


def _odd_modes(sheet: Sheet, share: Array) -> list[str]:
    """What speaks against `mode` and `negate` as they are given, by the shares (256,) of grey levels."""
    doubts = []
    if sheet.mode == "raw" and sheet.negate:
        doubts.append("negate: true is left out in the mode raw, as in nav2; invert the picture if it is meant")
    if (sheet.mode == "raw" or sheet.negate) and share[SAVED_UNKNOWN] > 0.0 and _marked(share) > SAVED_SHARE:
        doubts.append(f"greys as map_saver saves in the mode trinary, negate 0 (given: {sheet.mode}, {sheet.negate:d})")
    return doubts


def _is_saved(sheet: Sheet, share: Array) -> bool:
    """Whether a picture with these shares (256,) of grey levels looks as map_saver writes it: it has the mark of free
    cells, or no level but its marks.
    """
    marked = bool(share[SAVED_FREE:].any()) or _marked(share) > SAVED_SHARE
    return sheet.mode == "trinary" and not sheet.negate and marked


def _marked(share: Array) -> float:
    """The share of pixels with the marks of a map_saver in the mode trinary."""
    return float(share[SAVED_FREE:].sum() + share[0] + share[SAVED_UNKNOWN])


def _tell_moved(path: Path, given: str, image: Path) -> None:
    """Warn where the image is not at the path that the yaml file gives."""
    if _within(path.parent.resolve(), given) != image:
        place = str(image.relative_to(path.parent.resolve()))
        said = f"image: {shown(given)} is not there, or not in this folder; {place!r:.80} beside the yaml file is read"
        warnings.warn(f"{path.name!r:.80}: {said}", PlanWarning, stacklevel=4)


def image_of(path: Path) -> Path | None:
    """The image that a yaml file names, with all links followed; None where it names none that may be read."""
    try:
        return _beside(path, _sheet(path).image)
    except LayoutError:
        return None


class OnceLoader(yaml.SafeLoader):
    """Plain data in which no field is given twice: YAML forbids it, and PyYAML would keep the last.

    Numbers such as 1e-05 are numbers, as in YAML 1.2, which the map_saver of nav2 writes; PyYAML has text there.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """The mapping of a node. Raises LayoutError."""
        counts = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        for name, count in counts.items():
            if count > 1:
                raise LayoutError(f"{name:.80}: given {'twice' if count == 2 else f'{count} times'}")
        return super().construct_mapping(node, deep)


OnceLoader.add_implicit_resolver("tag:yaml.org,2002:float", WITHOUT_POINT, list("-+0123456789"))


def _sheet(path: Path) -> Sheet:
    """The checked fields of a yaml file."""
    data = read_bytes(path, MAX_YAML_BYTES)
    try:
        fields = yaml.load(text_of(data).replace("\t", " "), OnceLoader)  # PyYAML refuses tabs
    except LayoutError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise LayoutError(f"no yaml: {' '.join(str(error).split()):.160}") from None
    if not isinstance(fields, dict):
        raise LayoutError(f"a mapping with image, resolution and origin expected, given {type(fields).__name__}")
    foreign = of_yaml(fields) if "image" not in fields else ""
    if foreign.startswith("this is"):
        raise LayoutError(foreign)
    try:
        return Sheet(**{str(name): value for name, value in fields.items()})
    except LayoutError as error:
        raise LayoutError(f"{error}; {EXPECTED}") from None


def _beside(path: Path, given: str) -> Path:
    """The image file, in the folder of the yaml file or below: as it is written, or else of that name beside the yaml;
    capitals and the kind of slashes count at last.

    Nothing outside that folder is read. Raises LayoutError where neither exists.
    """
    folder, parts = path.parent.resolve(), PurePosixPath(given.replace("\\", "/")).parts
    name = "".join(parts[-1:])
    found = (_within(folder, written) for written in (given, _spelt(folder, parts), _spelt(folder, parts[-1:])))
    if image := next(filter(None, found), None):
        return image
    if exists(folder / given) and (folder / given).is_file():
        raise LayoutError(
            f"image: {shown(given)} leaves the folder of the yaml file, and nothing of that name is in it"
        )
    raise LayoutError(
        f"image: {shown(given)}: no such file in the folder of the yaml file or below{_missed(folder, given, name)}"
    )


def _missed(folder: Path, given: str, name: str) -> str:
    """What an error says of an image that is not there: the nearest name, or what to do."""
    beside = f" and no {shown(name)} beside the yaml file" if name not in ("", given) else ""
    files = [one for one in _names(folder) if not one.endswith((".yaml", ".yml")) and _within(folder, one)]
    return beside + (guess(name, files) or "; put the picture there, or correct the name")


def _spelt(folder: Path, parts: Sequence[str]) -> Path:
    """The path of `parts` from `folder`, each with the capitals of what is there."""
    for part in parts:
        exact = folder / part
        alike = (folder / name for name in _names(folder) if name.casefold() == part.casefold())
        folder = exact if exists(exact) else next(alike, exact)
    return folder


def _names(folder: Path) -> list[str]:
    """What is in a folder, in order; none where it cannot be listed."""
    try:
        return sorted(path.name for path in folder.iterdir())
    except (OSError, ValueError):
        return []


def _within(folder: Path, written: str | Path) -> Path | None:
    """The file at a path from `folder`, with all links followed; None where it does not exist or lies outside."""
    try:
        image = (folder / written).resolve()
    except (OSError, RuntimeError, ValueError):
        return None
    return image if image.is_relative_to(folder) and exists(image) and image.is_file() else None
