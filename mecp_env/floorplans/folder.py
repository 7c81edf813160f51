"""The plans in a folder and the folders in it."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

from mecp_env.core.errors import ConfigError, LayoutError, PlanWarning
from mecp_env.floorplans.foreign import why_no_plan
from mecp_env.floorplans.map_server import image_of

JSON, YAML, IMAGES = (".json",), (".yaml", ".yml"), (".png", ".pgm", ".ppm", ".pbm", ".bmp", ".tif", ".tiff")
ENDINGS = {"layout": JSON, "houseexpo": JSON, "map_server": YAML, "image": IMAGES, "labelled": IMAGES}  # of each kind
OF_A_RUN = (
    "belief.yaml",
    "metrics.json",
    "trajectory.tum",
)  # in a folder of `mecp-env demo`, where one of many JSON files is a plan
MAX_FILES = 100_000  # in a folder and those in it, plans or not


def plan_files(folder: Path, kind: str | None = None, images: bool = False) -> tuple[Path, ...]:
    """The plans in a folder and the folders in it, in the order of their paths; hidden ones are left out.

    With a `kind` only files that can be of it; without one JSON and yaml, and `images` that no yaml file names. JSON
    and yaml of another kind is left out, with a `PlanWarning`. Raises
    ConfigError for a folder of a run, without plans, or with too many files, and LayoutError for a link that leaves it.
    """
    _refuse_run(folder)
    endings = ENDINGS.get(kind or "", (*JSON, *YAML, *(IMAGES if images else ())))
    likely = _likely(folder, endings)
    reasons = {path: reason for path in likely if (reason := _why_no_plan(path))}
    _tell(folder, reasons)
    plans = tuple(path for path in likely if path not in reasons)
    if not plans:
        raise ConfigError(f"plan: {folder}, {_nothing(reasons, endings, images)}")
    return plans


def _likely(folder: Path, endings: tuple[str, ...]) -> list[Path]:
    """The files that end as plans do, in the order of their paths, without the images that a yaml file names."""
    files = sorted(_files(folder), key=lambda path: path.relative_to(folder).parts)
    named = {image_of(path) for path in files if path.suffix.lower() in YAML}
    return [path for path in files if path.suffix.lower() in endings and path.resolve() not in named]


def _nothing(reasons: dict[Path, str], endings: tuple[str, ...], images: bool) -> str:
    hint = "" if images else "; images are taken where resolution_m gives their metres per pixel"
    if not reasons:
        return f"no file in it ends in {', '.join(endings)}{hint}"
    path, reason = next(iter(reasons.items()))
    return f"none of {len(reasons)} files in it is a plan, as {path.name}: {reason}{hint}"


def _why_no_plan(path: Path) -> str:
    return why_no_plan(path) if path.suffix.lower() in (*JSON, *YAML) else ""


def _tell(folder: Path, reasons: dict[Path, str]) -> None:
    """Warn of the files that are left out, with their number and what the first is."""
    if reasons:
        first = next(iter(reasons))
        said = f"{len(reasons)} other file{'s' * (len(reasons) > 1)} left out, as {first.name}: {reasons[first]:.200}"
        warnings.warn(f"{folder}: {said}", PlanWarning, stacklevel=4)


def left_out(folder: Path, kind: str | None = None) -> dict[Path, str]:
    """The JSON and yaml files in a folder and those in it that are no plans, and why. Raises as `plan_files`."""
    endings = ENDINGS.get(kind or "", (*JSON, *YAML))
    files = (path for path in sorted(_files(folder)) if path.suffix.lower() in endings)
    return {path: reason for path in files if (reason := _why_no_plan(path))}


def _refuse_run(folder: Path) -> None:
    """Raises ConfigError for a folder of `mecp-env demo`, whose JSON files are no plans."""
    if all((folder / name).is_file() for name in OF_A_RUN):
        raise ConfigError(
            f"plan: {folder} holds a run, not buildings; the believed map of it is {folder / OF_A_RUN[0]}"
        )


def _files(folder: Path) -> Iterator[Path]:
    """All files that are not hidden; links to folders are not followed."""
    root, count = folder.resolve(), 0
    for place, folders, names in os.walk(folder):
        folders[:] = (name for name in folders if not name.startswith("."))
        count += len(names)
        if count > MAX_FILES:
            raise ConfigError(f"plan: {folder} has more than {MAX_FILES} files")
        paths = [Path(place, name) for name in (*folders, *names) if not name.startswith(".")]
        outside = (path for path in paths if path.is_symlink() and not path.resolve().is_relative_to(root))
        for path in outside:
            raise LayoutError(f"{path}: a link that leaves the folder of the plans")
        yield from paths[len(folders) :]
