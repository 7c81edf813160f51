"""Writes `croissant.json` beside this file: the frozen benchmarks as a dataset in the format Croissant 1.0.

    pip install -e ".[publish]"
    python publishing/croissant.py [DATE OF THE RELEASE, such as 2027-01-31]

The buildings are not files: `mecp_env` generates them from the task, the split and a number, the same in every place.
So the records are the settings of each suite, with the hash that changes when any of them would, and the files are the
results of the reference policies.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Any

import mlcroissant as mlc

from mecp_env.policies.suites import FOLDER, SUITES
from mecp_env.world.config import SPLITS

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
NAMES = ("active-v1", "coverage-v1")
TEXT, INTEGER, SPLIT = mlc.DataType.TEXT, mlc.DataType.INTEGER, mlc.DataType.SPLIT
COLUMNS = {  # of the records of a suite: type and description
    "suite": (TEXT, "Name of the frozen benchmark."),
    "setting": (TEXT, "Task of active SLAM, or difficulty of the buildings."),
    "split": (TEXT, "Split of the buildings, which no policy was trained or chosen on."),
    "buildings": (INTEGER, "The first so many buildings of the split, by their numbers from 0 on."),
    "max_steps": (INTEGER, "Control steps of an episode."),
    "hash": (TEXT, "16 hexadecimal digits over settings, starts and sample buildings."),
}
DESCRIPTION = (
    "Frozen benchmarks of active SLAM indoors: generated buildings with doors and rooms, a robot with odometry and "
    "laser, and an EKF-SLAM with Maximum Empty Convex Polygon data association in every step. A policy is scored by "
    "the share of the floor that is in the map at its place, as a mean over the steps."
)


def records() -> list[dict[str, Any]]:
    """A record per setting of each suite."""
    return [
        {
            "suites/suite": name,
            "suites/setting": setting.name,
            "suites/split": setting.split,
            "suites/buildings": SUITES[name].episodes,
            "suites/max_steps": setting.max_steps,
            "suites/hash": SUITES[name].frozen,
        }
        for name in NAMES
        for setting in SUITES[name].settings
    ]


def files() -> list[mlc.FileObject]:
    """The results of the reference policies."""
    return [
        mlc.FileObject(
            id=path.name,
            name=path.name,
            description=f"Figures of the reference policies in {path.stem}.",
            content_url=path.relative_to(ROOT).as_posix(),
            encoding_formats=["application/json"],
            sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        )
        for path in sorted(FOLDER.glob("*.json"))
        if path.stem in NAMES
    ]


def field(parent: str, name: str, kind: str, text: str) -> mlc.Field:
    """A column of a set of records."""
    return mlc.Field(id=f"{parent}/{name}", name=f"{parent}/{name}", description=text, data_types=[kind])


def metadata(published: datetime | None) -> dict[str, Any]:
    """The content of `croissant.json`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    splits = mlc.RecordSet(
        id="splits",
        name="splits",
        description="Splits of the generated buildings.",
        key="splits/name",
        fields=[field("splits", "name", TEXT, "Name of the split.")],
        data_types=[SPLIT],
        data=[{"splits/name": split} for split in SPLITS],
    )
    suites = mlc.RecordSet(
        id="suites",
        name="suites",
        description="Settings of the frozen benchmarks.",
        fields=[field("suites", name, kind, text) for name, (kind, text) in COLUMNS.items()],
        data=records(),
    )
    return mlc.Metadata(
        name=project["name"],
        description=DESCRIPTION,
        version=project["version"],
        date_published=published,
        cite_as=f"{project['authors'][0]['name']}: {project['description']}",
        license=[f"https://spdx.org/licenses/{project['license']}.html"],
        distribution=files(),
        record_sets=[splits, suites],
    ).to_json()


if __name__ == "__main__":
    content = metadata(datetime.fromisoformat(sys.argv[1]) if len(sys.argv) > 1 else None)
    (HERE / "croissant.json").write_text(json.dumps(content, indent=1, default=str) + "\n", encoding="utf-8")
