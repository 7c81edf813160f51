"""Records the drives that other benchmarks replay, in `runs/records` or the folder of `--records`.

`--sets NAME[:COUNT]` records those of some benchmarks, and the first COUNT drives of each of their sets. Records that
are there are read and checked, never written again. `content` is a checksum over the content hashes of all records:
two machines with the same one replay the same bits.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks import association, association_time, clutter, consistency, kidnap, loop, noise, sensors
from benchmarks.common import Figures, Options, chosen, grouped, in_parallel
from benchmarks.records import HEADER, Course, Records
from benchmarks.tables import table_of
from mecp_env.core.provenance import checksum

ALL, QUICK = 1000, 2  # drives of each set
COURSES: dict[str, Callable[[int], list[Course]]] = {  # of the benchmarks, with so many drives of each set
    "association": lambda most: courses_of(association.course, association.SETS, most),
    "association_time": lambda most: courses_of(loop.course, association_time.SETS, most),
    "clutter": lambda most: courses_of(clutter.course, clutter.SETS, most),
    "consistency": lambda most: courses_of(consistency.course, consistency.SETS, most),
    "kidnap": lambda most: [
        kidnap.course(layout, seed, start)
        for layout, count in kidnap.SETS.items()
        for seed in range(min(count, most))
        for start in (seed, seed + kidnap.SECOND_DRIVE)
    ],
    "loop": lambda most: courses_of(loop.course, loop.SETS, most),
    "noise": lambda most: courses_of(noise.course, dict.fromkeys(noise.RECORDED, noise.SETS[noise.BASE]), most),
    "sensors": lambda most: courses_of(sensors.course, sensors.SETS, most),
}
SETS = dict.fromkeys(COURSES, ALL)


def courses_of(course: Callable[[str, int], Course], counts: dict[str, int], most: int) -> list[Course]:
    """The courses of each set, the first `most` of them."""
    return [course(name, seed) for name, count in counts.items() for seed in range(min(count, most))]


def run(options: Options) -> Figures:
    """What was recorded, by benchmark; a record of two benchmarks counts in both."""
    counts = chosen(options.sets, SETS, ALL) or dict.fromkeys(COURSES, QUICK if options.quick else ALL)
    drives = [(name, most, index) for name, most in counts.items() for index in range(len(COURSES[name](most)))]
    made = in_parallel(partial(make, Records(options.records)), Figures, drives, options)
    return {name: summarise(of_name) for (name, _), of_name in grouped(drives, made).items()}


def make(records: Records, unit: tuple[str, int, int]) -> Figures:
    """Make or check one record; its size and content hash."""
    name, most, index = unit
    course = COURSES[name](most)[index]
    drive = records.drive(course)
    assert records.folder is not None
    path = records.folder / course.file
    with np.load(path, allow_pickle=False) as record:
        content = json.loads(record[HEADER].tobytes())["content"]
    return {"scans": len(drive.scans), "bytes": path.stat().st_size, "content": content}


def summarise(made: list[Figures]) -> Figures:
    """Number, size and checksum of the records of one benchmark."""
    content = checksum("".join(sorted(one["content"] for one in made)).encode())
    sizes = {"scans": sum(one["scans"] for one in made), "MB": round(sum(one["bytes"] for one in made) / 1e6, 1)}
    return {"records": len(made), **sizes, "content": content}


def report(figures: Figures) -> str:
    """One table."""
    columns = ("records", "scans", "MB", "content")
    return table_of("benchmark", columns, figures)
