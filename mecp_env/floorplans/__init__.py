"""Real floor plans: files of other projects as layouts, with rooms and doors found in them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal, get_args

from shapely.errors import GEOSException

from mecp_env.core.errors import LayoutError
from mecp_env.core.paths import exists, read_bytes
from mecp_env.core.settings import guess
from mecp_env.floorplans.assemble import layout_of
from mecp_env.floorplans.files import MAX_JSON_BYTES
from mecp_env.floorplans.folder import IMAGES, YAML, plan_files
from mecp_env.floorplans.houseexpo import read_houseexpo
from mecp_env.floorplans.image import read_plain_image
from mecp_env.floorplans.labelled import read_labelled_image
from mecp_env.floorplans.map_server import read_map_server
from mecp_env.floorplans.options import PlanOptions
from mecp_env.world.layout import MAX_BYTES, decode_json, load_layout
from mecp_env.world.schema import Layout

__all__ = ["KINDS", "PlanOptions", "load_plan", "plan_files"]

Kind = Literal["layout", "houseexpo", "map_server", "image", "labelled"]
KINDS: tuple[str, ...] = get_args(Kind)


def load_plan(
    path: str | os.PathLike[str], *, kind: Kind | None = None, resolution_m: float | None = None, **options: Any
) -> Layout:
    """The layout of a plan file: our JSON, HouseExpo JSON, a map_server yaml, or a PNG or PGM image.

    `kind` is found by what is in the file; only a labelled image has to be called `"labelled"`. An image without a
    yaml file needs `resolution_m`, metres per pixel. `options` are the fields of `PlanOptions`.

    Raises LayoutError naming file, field, value and bound for a file that is damaged, out of its limits or impossible,
    and ConfigError for a wrong option.
    """
    chosen = PlanOptions(resolution_m=resolution_m, **options)
    if kind not in (None, *KINDS):
        raise LayoutError(f"kind: one of {', '.join(KINDS)} expected (given: {kind!r:.80}){guess(kind, KINDS)}")
    try:
        return _load(Path(path), kind, chosen)
    except LayoutError as error:
        raise error if str(error).startswith(f"{path}: ") else LayoutError(f"{path!s:.300}: {error}") from None
    except GEOSException as error:
        raise LayoutError(f"{path!s:.300}: its geometry cannot be computed ({error})") from None


def _load(path: Path, kind: Kind | None, options: PlanOptions) -> Layout:
    if path.suffix.lower() in IMAGES:
        reader = read_labelled_image if _agreed(kind, "image", "labelled") == "labelled" else read_plain_image
        return layout_of(reader(path, options), options)
    if path.suffix.lower() in YAML:
        _agreed(kind, "map_server")
        return layout_of(read_map_server(path, options), options)
    if path.suffix.lower() != ".json":
        if not exists(path):
            raise LayoutError("no such file or folder")
        raise LayoutError(f"a plan file ends in .json, {', '.join((*YAML, *IMAGES))}, given {path.suffix!r:.80}")
    return _load_json(path, kind, options)


def _agreed(kind: Kind | None, *possible: Kind) -> Kind:
    """`kind`, or the first of what the file can be. Raises LayoutError when it cannot be that."""
    if kind is not None and kind not in possible:
        raise LayoutError(f"kind: {kind}, but by its ending the file is {' or '.join(possible)}")
    return kind or possible[0]


def _load_json(path: Path, kind: Kind | None, options: PlanOptions) -> Layout:
    data = read_bytes(path, MAX_JSON_BYTES)
    document = decode_json(data)
    found: Kind = "houseexpo" if "verts" in document else "layout"
    if found == "layout" and len(data) > MAX_BYTES:
        raise LayoutError(f"the file has {len(data)} bytes, at most {MAX_BYTES} of a layout")
    if _agreed(kind, "layout", "houseexpo") != found and kind is not None:
        raise LayoutError(f"kind: {kind}, but the fields are those of {found}")
    return load_layout(document) if found == "layout" else layout_of(read_houseexpo(document, path), options)
