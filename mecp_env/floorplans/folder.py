"""The plans in a folder and the folders in it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Collection
from pathlib import Path

from mecp_env.core.errors import ConfigError, LayoutError, PlanWarning
from mecp_env.floorplans.foreign import why_no_plan
from mecp_env.floorplans.map_server import image_of

JSON, YAML, IMAGES = (".json",), (".yaml", ".yml"), (".png", ".pgm", ".ppm", ".pbm", ".bmp", ".tif", ".tiff")
ENDINGS = {"layout": JSON, "houseexpo": JSON, "map_server": YAML, "image": IMAGES, "labelled": IMAGES}  # of each kind
OF_A_RUN = ("belief.yaml", "metrics.json", "trajectory.tum")  # in a folder of `mecp-env demo`
PER_PIXEL = "; images are taken where resolution_m gives their metres per pixel"
MAX_FILES = 100_000  # in a folder and those in it, plans or not


def plan_files(folder: Path, kind: str | None = None, images: bool = False) -> tuple[Path, ...]:
    """The plans in a folder and the folders in it, in the order of their paths; hidden ones are left out.

    With a `kind` only files that can be of it; without one JSON and yaml, and `images` that no yaml file names. JSON
    and yaml of another kind is left out, with a `PlanWarning`. Raises
    ConfigError for a folder of a run, without plans, or with too many files, and LayoutError for a link that leaves it.
    """
    _refuse_run(folder)
    endings = ENDINGS.get(str(kind), (*JSON, *YAML, *(IMAGES if images else ())))
    named = {image_of(path) for path in _files(folder, YAML)}
    reasons = left_out(folder, kind)
    first = _tell(folder, reasons) if reasons else ""
    plans = tuple(path for path in _files(folder, endings) if path.resolve() not in named and path not in reasons)
    if not plans:
        none = f"none of {len(reasons)} files in it is a plan, {first}" * bool(reasons)
        none = none or f"no file in it ends in {', '.join(endings)}"
        raise ConfigError(f"plan: {folder}, {none}{PER_PIXEL * (not images)}")
    return plans


def _tell(folder: Path, reasons: dict[Path, str]) -> str:
    """Warn of the files that are left out, with their number and the first; what that is."""
    path, reason = next(iter(reasons.items()))
    said = f"{len(reasons)} other file{'s' * (len(reasons) > 1)} left out, as {path.name}: {reason:.200}"
    warnings.warn(f"{folder}: {said}", PlanWarning, stacklevel=4)
    return f"as {path.name}: {reason}"


def _refuse_run(folder: Path) -> None:
    """Raises ConfigError for a folder of `mecp-env demo`, whose JSON files are no plans."""
    if all((folder / name).is_file() for name in OF_A_RUN):
        raise ConfigError(
            f"plan: {folder} holds a run, not buildings; the believed map of it is {folder / OF_A_RUN[0]}"
        )


def left_out(folder: Path, kind: str | None = None) -> dict[Path, str]:
    """The JSON and yaml files in a folder and those in it that are no plans, and why. Raises as `plan_files`."""
    endings = set(ENDINGS.get(kind or "", (*JSON, *YAML))) - set(IMAGES)
    return {path: reason for path in _files(folder, endings) if (reason := why_no_plan(path))}


def _files(folder: Path, endings: Collection[str]) -> list[Path]:
    """All files with such endings that are not hidden, in the order of their paths; links to folders are not followed.

    Raises as `plan_files`.
    """
    root, count, found = folder.resolve(), 0, list[Path]()
    for place, folders, names in os.walk(folder):
        folders[:] = (name for name in folders if not name.startswith("."))
        count += len(names)
        if count > MAX_FILES:
            raise ConfigError(f"plan: {folder} has more than {MAX_FILES} files")
        paths = [Path(place, name) for name in (*folders, *names) if not name.startswith(".")]
        for path in filter(Path.is_symlink, paths):
            if not path.resolve().is_relative_to(root):
                raise LayoutError(f"{path}: a link that leaves the folder of the plans")
        found += paths[len(folders) :]
    return sorted(path for path in found if path.suffix.lower() in endings)
