"""Real floor plans: files of other projects as layouts, with rooms and doors found in them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Literal

from shapely.errors import GEOSException

from mecp_env.core.errors import LayoutError
from mecp_env.core.files import exists, is_folder, read_bytes
from mecp_env.core.settings import guess
from mecp_env.floorplans.assemble import layout_of
from mecp_env.floorplans.folder import ENDINGS, plan_files
from mecp_env.floorplans.foreign import by_ending, of_json
from mecp_env.floorplans.houseexpo import read_houseexpo
from mecp_env.floorplans.image import read_labelled_image, read_plain_image
from mecp_env.floorplans.map_server import read_map_server
from mecp_env.floorplans.options import PlanOptions
from mecp_env.world.layout import MAX_BYTES, decode_json, load_layout
from mecp_env.world.schema import Layout

__all__ = ["PlanOptions", "load_plan", "plan_files"]

Kind = Literal["layout", "houseexpo", "map_server", "image", "labelled"]
OURS = Layout.model_fields.keys() - {"name", "description", "version"}  # fields that JSON of other kinds lacks
READERS = {"map_server": read_map_server, "image": read_plain_image, "labelled": read_labelled_image}


def load_plan(
    path: str | os.PathLike[str], *, kind: Kind | None = None, resolution_m: float | None = None, **options: Any
) -> Layout:
    """The layout of a plan file: our JSON, HouseExpo JSON, a map_server yaml, or an image (PNG, PGM, BMP, TIFF).

    `kind` is found by what is in the file; only a labelled image has to be called `"labelled"`. An image without a
    yaml file needs `resolution_m`, metres per pixel. `options` are the fields of `PlanOptions`.

    Raises LayoutError naming file, field, value and bound for a file that is damaged, out of its limits or impossible,
    and ConfigError for a wrong option.
    """
    chosen = PlanOptions(resolution_m=resolution_m, **options)
    if kind not in (None, *ENDINGS):
        raise LayoutError(f"kind: one of {', '.join(ENDINGS)} expected (given: {kind!r:.80}){guess(kind, ENDINGS)}")
    try:
        return _load(Path(path), kind, chosen)
    except LayoutError as error:
        raise error if str(error).startswith(f"{path}: ") else LayoutError(f"{path!s:.300}: {error}") from None
    except GEOSException as error:
        raise LayoutError(f"{path!s:.300}: its geometry cannot be computed ({error})") from None


def _load(path: Path, kind: Kind | None, options: PlanOptions) -> Layout:
    found = _kind_of(path, kind)
    if found in READERS:
        return layout_of(READERS[found](path, options), options)
    document = decode_json(read_bytes(path, MAX_BYTES))
    foreign = of_json(document)
    if foreign.startswith("this is") or (foreign and not document.keys() & OURS):
        raise LayoutError(foreign)
    found = "houseexpo" if "verts" in document else "layout"
    if kind not in (None, found):
        raise LayoutError(f"kind: {kind}, but the fields are those of {found}")
    return load_layout(document) if found == "layout" else layout_of(read_houseexpo(document, path), options)


def _kind_of(path: Path, kind: Kind | None) -> str:
    """`kind`, or the first of what the file can be by its ending. Raises LayoutError when it cannot be that."""
    if is_folder(path):
        raise LayoutError("a folder, where one plan is expected; name a file in it")
    possible = [name for name, endings in ENDINGS.items() if path.suffix.lower() in endings]
    if not possible:
        raise LayoutError(by_ending(path) if exists(path) else "no such file or folder")
    if kind not in (None, *possible):
        raise LayoutError(f"kind: {kind}, but by its ending the file is {' or '.join(possible)}")
    return kind or possible[0]
