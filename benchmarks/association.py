"""Association in closed loop: the associators on the same breadth-first drives (derivations 3.4).

`mecp_paper` follows the association of the paper literally, with the features and the filter of `mecp`, and posts that
are no landmarks; `SlamConfig.paper()` is the paper's in every stage. Each row "without" disables one part of `mecp`.
The others are defined in docs/associators.md, and use descriptors and rooms only where their name says so. Parts
registered by the modules of `--with` have rows too: an associator, or `mecp` with another filter.

The identity of a landmark is the true corner that it was matched with most often. An *event* is the return to a room
that was not visited for at least 30 scans and of which at least two mapped corners are visible. It succeeds when five
scans contain at least two correct matches and no wrong one, and is a false closure when they contain at least two wrong
ones. A match of a corner without a true identity counts as wrong. `landmark_nees` is the mean NEES of the landmarks at
the end of a drive, `pair_nees` that of the offset of two landmarks matched in one scan (2 expected of both). `hard` are
generated buildings of the test split, those of `loop`. The sets differ in their laser only where they say so: the paper
"assumes" the sigmas of its laser (IV), which is noise on every beam in `paper`, and in `paper_ideal` the assumption of
a filter whose laser is ideal. `associate_ms` are the milliseconds of association
per scan, the median of a drive.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks import loop
from benchmarks.common import Figures, Options, estimate
from benchmarks.drives import Drive, Replay
from benchmarks.records import HARD, IN_MEMORY, Course, Records, on_drives, place
from benchmarks.tables import columns_of, summary
from benchmarks.variants import DEFAULT, LETTER, RIVALS, Variant, own_rows, replays, rows_of
from mecp_env.core.carriers import Ints
from mecp_env.evaluation.metrics import AssociationLog

METHODS = rows_of(
    *(DEFAULT, "mecp without descriptor", "mecp without polygons", "mecp without rooms", "mecp_paper"),
    *(*RIVALS, "nearest", LETTER),
)
IDEAL = "paper_ideal"
ASSUMED: dict[str, Any] = {  # the other reading of IV
    "laser": {"preset": "ideal"},
    "slam": {"sensor": {"range_sigma_m": 0.05, "bearing_sigma_deg": 0.3}},
}
SETS = {"paper": 60, IDEAL: 15, "two_rooms": 15, "office": 15, "twins": 15, "furnished": 15, HARD: 20}
AWAY_SCANS, WITHIN_SCANS, ACROSS_WALL_M = 30, 5, 0.4
COLUMNS = ("precision", "recall", "wrong_per_1000", "duplicates_per_corner", "closure_recall", "false_closures")
COLUMNS += ("after_door_wrong", "swapped_per_1000", "rmse_m", "map_rmse_m", "nees", "landmark_nees")
COLUMNS += ("pair_nees", "lost", "associate_ms")


def run(options: Options) -> Figures:
    """Results of every layout and associator, with its differences to `mecp` on the same drives."""
    return {
        layout: {name: summarise(own) | differences(own, rows[DEFAULT]) for name, own in rows.items()}
        for layout, rows in on_drives(compare, SETS, options).items()
    }


def course(layout: str, seed: int) -> Course:
    """What is driven."""
    if layout == IDEAL:
        return Course("paper", seed, ASSUMED)
    limit = {"max_steps": loop.MAX_STEPS} if layout == HARD else {}
    return Course(place(layout, loop.FIRST_BUILDING + seed), seed, limit)


def compare(drive_of: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts for each associator on the drive of one layout and seed."""
    return counted(records.drive(course(*drive_of)), METHODS | own_rows())


def counted(drive: Drive, rows: Mapping[str, Variant]) -> dict[str, Figures]:
    """Counts of each row on a drive."""
    return {name: counts(drive, outcome) for name, outcome in replays(drive, rows).items()}


def counts(drive: Drive, outcome: Replay) -> Figures:
    """Counts of one drive. The true corners of a matched corner and of its landmark are `true` and `claimed`, or -1."""
    step, true, feature, matched = outcome.log.rows[: outcome.log.used].T
    claimed = np.where(matched > 0, outcome.log.features[feature, 0], -1)
    wrong = (matched > 0) & ((true < 0) | (claimed != true))
    rooms = rooms_of(drive)[: len(outcome.error_m)]
    events = closures(drive, outcome.log, rooms, (step, true, claimed, wrong))
    after_door = np.isin(step, [p + k for p in np.flatnonzero(np.diff(rooms)) + 2 for k in range(WITHIN_SCANS)])
    swapped = across_a_wall(drive, *(corner[wrong & (true >= 0) & (claimed >= 0)] for corner in (true, claimed)))
    return outcome.counts | {
        "thousands": len(true) / 1000.0,
        "mapped": len(np.unique(claimed[claimed >= 0])),
        "events": len(events),
        "closed": sum(right >= 2 and wrong == 0 for right, wrong in events),
        "false_closures": sum(wrong >= 2 for _, wrong in events),
        "after_door": int(after_door.sum()),
        "after_door_wrong": int((after_door & wrong).sum()),
        "swapped": swapped,
    }


def rooms_of(drive: Drive) -> Ints:
    """(n,) true room of the robot at each scan; in a doorway the room it came from."""
    rooms = [drive.truth.room_at(pose[:2]) for pose in drive.T_world_robot]
    for i, room in enumerate(rooms):
        rooms[i] = room if room >= 0 else rooms[i - 1]
    return np.array(rooms)


def closures(drive: Drive, log: AssociationLog, rooms: Ints, pairs: Sequence[Any]) -> list[tuple[int, int]]:
    """Correct and wrong matches within five scans of each return to a room; see the module docstring."""
    step, true, claimed, wrong = pairs
    # corners of this room, and spurious corners matched with one of them
    subject = np.where(true >= 0, true, claimed)
    corner_room = drive.truth.outline.room_at(drive.truth.outline.corners.p_world)
    room_of = np.where(subject >= 0, corner_room[subject], -2)
    last_visit: dict[int, int] = {}
    events = []
    for i, room in enumerate(rooms.tolist()):
        returned = i > 0 and rooms[i - 1] != room and i - last_visit.get(room, i) >= AWAY_SCANS
        last_visit[room] = i
        window = (step > i) & (step <= i + WITHIN_SCANS) & (room_of == room)
        seen = np.unique(true[window & (true >= 0)])
        mapped = np.intersect1d(seen, log.features[log.features[:, 1] < i, 0])
        if returned and len(mapped) >= 2:
            right = window & (claimed >= 0) & ~wrong
            events.append((int(right.sum()), int((window & wrong).sum())))
    return events


def across_a_wall(drive: Drive, true: Ints, claimed: Ints) -> int:
    """How many corners are taken for others of another room within 0.4 m: the two faces of a thin wall."""
    corners = drive.truth.outline.corners
    apart = np.hypot(*(corners.p_world[true] - corners.p_world[claimed]).T)
    room = drive.truth.outline.room_at(corners.p_world)
    return int(((room[true] != room[claimed]) & (apart < ACROSS_WALL_M)).sum())


def summarise(runs: list[Figures]) -> Figures:
    """Results of all seeds, each with its 95 % interval."""
    return summary(runs, (*COLUMNS, "events"))


def differences(runs: Sequence[Figures], base: Sequence[Figures]) -> Figures:
    """Mean difference of a method to `mecp` over the same drives, with its 95 % interval."""
    own, other = (columns_of([of_drive(run) for run in some]) for some in (runs, base))
    return {f"{name}_minus_mecp": estimate(own[name] - other[name]) for name in own}


def of_drive(row: Figures) -> Figures:
    """Precision (1 without a match), recall and pose RMSE of one drive."""
    right, paired = row["tp"], row["tp"] + row["fp"]
    recall = right / max(right + row["fn"], 1)
    return {"precision": right / paired if paired else 1.0, "recall": recall, "rmse_m": row["rmse_m"]}
