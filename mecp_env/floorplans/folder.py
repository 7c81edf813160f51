"""The plans in a folder and the folders in it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from mecp_env.core.errors import ConfigError, LayoutError
from mecp_env.floorplans.map_server import image_of

JSON, YAML, IMAGES = (".json",), (".yaml", ".yml"), (".png", ".pgm", ".ppm", ".pbm")
ENDINGS = {"layout": JSON, "houseexpo": JSON, "map_server": YAML, "image": IMAGES, "labelled": IMAGES}  # of each kind
OF_A_RUN = ("belief.yaml", "metrics.json", "trajectory.tum")  # in a folder of `mecp-env demo`
MAX_FILES = 100_000  # in a folder and those in it, plans or not
MAX_LEVELS = 16


def plan_files(folder: Path, kind: str | None = None, images: bool = False) -> tuple[Path, ...]:
    """The plans in a folder and the folders in it, in the order of their paths; hidden ones are left out.

    With a `kind` only files that can be of it; without one JSON and yaml, and `images` that no yaml file names. Raises
    ConfigError for a folder of a run, without plans, with too many files or levels, and LayoutError for a link that
    leaves it.
    """
    _refuse_run(folder)
    endings = ENDINGS.get(kind or "", (*JSON, *YAML, *(IMAGES if images else ())))
    files = sorted(_files(folder, folder.resolve()), key=lambda path: path.relative_to(folder).parts)
    named = _named_images(files) if set(IMAGES) & set(endings) else set()
    plans = [path for path in files if path.suffix.lower() in endings and path.resolve() not in named]
    if not plans:
        hint = "" if images else "; images are taken where resolution_m gives their metres per pixel"
        raise ConfigError(f"plan: {folder}, no file in it ends in {', '.join(endings)}{hint}")
    return tuple(plans)


def _refuse_run(folder: Path) -> None:
    """Raises ConfigError for what `mecp-env demo` leaves: it has one plan, among JSON files that are none."""
    if all((folder / name).is_file() for name in OF_A_RUN):
        raise ConfigError(
            f"plan: {folder} holds a run, not buildings; the believed map of it is {folder / OF_A_RUN[0]}"
        )


def _named_images(files: list[Path]) -> set[Path | None]:
    """The images of the yaml files."""
    return {image_of(path) for path in files if path.suffix.lower() in YAML}


def _files(folder: Path, root: Path) -> Iterator[Path]:
    """All files that are not hidden; links to folders are not followed."""
    count = 0
    for place, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        if len(Path(place).relative_to(folder).parts) > MAX_LEVELS:
            raise ConfigError(f"plan: {place}, more than {MAX_LEVELS} folders in each other")
        count += len(names)
        if count > MAX_FILES:
            raise ConfigError(f"plan: {folder} has more than {MAX_FILES} files")
        for name in (*folders, *names):
            _require_inside(Path(place) / name, root)
        yield from (Path(place) / name for name in names if not name.startswith("."))


def _require_inside(path: Path, root: Path) -> None:
    if path.is_symlink() and not path.resolve().is_relative_to(root):
        raise LayoutError(f"{path}: a link that leaves the folder of the plans")
