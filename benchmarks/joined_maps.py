"""One large map of many small ones: saved maps laid side by side, to search for a pose among hundreds of rooms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.drives import record_drive
from benchmarks.loop import HARD, MAX_STEPS, finish
from mecp_env.core.carriers import Array, Ints
from mecp_env.slam.filters.core import LandmarkFilter
from mecp_env.slam.filters.models import change_chart
from mecp_env.slam.messages import UNKNOWN_ROOM, Candidate, Door, MapPolygon
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.world.generator import GeneratorSpec, generate, split_seed

Pair = tuple[int, int]

FIRST_BUILDING = 700  # of those that are joined; other benchmarks use those before
AISLE_M = 2.0  # of nothing between two maps
POSE, ORDER = 3, [2, 0, 1]  # numbers of the pose at the beginning of a filter's state: heading, x, y


@dataclass(frozen=True, slots=True, eq=False)
class Joined:
    """The large map, and where each of the small ones is in it."""

    pipeline: SlamPipeline
    shifts: Array  # (m,2) m, added to the places of a map
    first_feature: Ints  # (m,) added to its feature ids
    first_room: Ints  # (m,) added to its rooms


@dataclass(frozen=True, slots=True)
class Shift:
    """How one map is moved: its places by `p`, its ids and rooms by what comes before."""

    p: Array  # (2,) m
    feature: int
    room: int
    door: int

    def ids(self, pair: Pair) -> Pair:
        """Feature ids, those that are unknown as they are."""
        first, second = (i + self.feature if i >= 0 else i for i in pair)
        return first, second

    def rooms(self, pair: Pair) -> Pair:
        """Rooms, those that are unknown as they are."""
        first, second = (room + self.room if room != UNKNOWN_ROOM else room for room in pair)
        return first, second

    def polygon(self, known: MapPolygon) -> MapPolygon:
        """A map polygon."""
        return replace(known, ids=known.ids + self.feature, room=known.room + self.room)

    def doorway(self, known: Door) -> Door:
        """A door."""
        other = None if known.other_face is None else self.ids(known.other_face)
        rooms = self.rooms(known.rooms)
        return replace(known, id=known.id + self.door, jambs=self.ids(known.jambs), other_face=other, rooms=rooms)

    def candidate(self, known: Candidate) -> Candidate:
        """A gap that may be a door."""
        return replace(known, ends=known.ends + self.p, ids=self.ids(known.ids), room=known.room + self.room)


def saved_maps(folder: Path, rooms: int) -> list[SlamPipeline]:
    """Maps of different buildings with so many rooms together, from a folder; those that it lacks are made there.

    The default estimator makes each on a drive with the true pose as the driver, as in the benchmark `loop`.
    """
    maps: list[SlamPipeline] = []
    while sum(len(one.rooms.rooms) for one in maps) < rooms:
        path = folder / f"{HARD}-{len(maps)}.zip"
        if not path.exists():
            layout = generate(GeneratorSpec.preset(HARD), split_seed("test", FIRST_BUILDING + len(maps)))
            drive = record_drive(layout, len(maps), estimator="truth", max_steps=MAX_STEPS)
            finish(drive).pipeline.save_map(path)
        maps.append(SlamPipeline.from_map(path))
    return maps


def join(maps: Sequence[SlamPipeline]) -> Joined:
    """The maps in rows and columns: landmarks with their covariance, features, polygons, rooms and doors; no grid.

    Maps are independent of each other, and the pose is that of the first. The maps stay as they are. 10,000 landmarks
    are the most that a filter takes; its covariance then needs 3 GB.
    """
    places, features = side_by_side(maps), starts([len(one.map.features) for one in maps])
    rooms, doors = (starts([number(one) for one in maps]) for number in (next_room, next_door))
    shifts = [Shift(*shift) for shift in zip(places, features.tolist(), rooms.tolist(), doors.tolist(), strict=True)]
    config, count = maps[0].config, sum(len(one.filter.ids) for one in maps)
    most = max(config.filter.max_landmarks, count)
    config = type(config)(**config.model_dump() | {"filter": config.filter.model_dump() | {"max_landmarks": most}})
    pipeline = SlamPipeline(config)
    pipeline.step_count = max(one.step_count for one in maps)
    join_filters(pipeline, maps, shifts)
    join_features(pipeline, maps, shifts)
    join_rooms(pipeline, maps, shifts)
    return Joined(pipeline, places, features, rooms)


def next_room(one: SlamPipeline) -> int:
    """The number of rooms that a map ever had."""
    return one.rooms.next_room


def next_door(one: SlamPipeline) -> int:
    """The number of doors that a map ever had."""
    return one.rooms.door_map.next_id


def starts(counts: list[int]) -> Ints:
    """(m,) how many come before each."""
    return np.cumsum([0, *counts[:-1]])


def side_by_side(maps: Sequence[SlamPipeline]) -> Array:
    """(m,2) shifts by which maps do not overlap: rows from the bottom, together about as wide as high."""
    beliefs = [one.filter.belief().p_map for one in maps]
    corners = np.array([(p_map.min(axis=0), p_map.max(axis=0)) for p_map in beliefs])
    size = np.ptp(corners, axis=1).max(axis=0) + AISLE_M
    columns = math.ceil(math.sqrt(len(maps) * size[1] / size[0]))
    row, column = np.divmod(np.arange(len(maps)), columns)
    cells = np.stack((column, row), axis=1) * size
    shifts: Array = cells - cells.mean(axis=0) - corners[:, 0]
    return shifts


def join_filters(pipeline: SlamPipeline, maps: Sequence[SlamPipeline], shifts: list[Shift]) -> None:
    """All landmarks in one filter: each map's own covariance, nothing between maps."""
    joined = pipeline.filter
    assert isinstance(joined, LandmarkFilter)
    ids = [one.filter.ids + shift.feature for one, shift in zip(maps, shifts, strict=True)]
    joined.slot_ids = np.concatenate(ids)
    joined.state = np.zeros((1 + joined.size, joined.size))
    mean, cov = maps[0].filter.marginal(ids[0][:0])
    joined.mean[:POSE], joined.cov[:POSE, :POSE] = (
        (mean + np.append(shifts[0].p, 0.0))[ORDER],
        cov[np.ix_(ORDER, ORDER)],
    )
    slot = POSE
    for one, shift in zip(maps, shifts, strict=True):
        mean, cov = one.filter.marginal(one.filter.ids)
        end = slot + len(mean) - POSE
        joined.mean[slot:end] = (mean[POSE:].reshape(-1, 2) + shift.p).ravel()
        joined.cov[slot:end, slot:end] = cov[POSE:, POSE:]
        slot = end
    change_chart(joined.state, joined.size, -1.0, joined.invariant)


def join_features(pipeline: SlamPipeline, maps: Sequence[SlamPipeline], shifts: list[Shift]) -> None:
    """All features and polygons under new ids."""
    store = pipeline.map.polygons
    for one, shift in zip(maps, shifts, strict=True):
        rows = one.map.features.rows.copy()
        rows["room"][rows["room"] != UNKNOWN_ROOM] += shift.room
        rows["p_map"] += shift.p
        pipeline.map.features.append(rows)
        store.polygons += map(shift.polygon, one.map.polygons.polygons)
    store.outdated = True


def join_rooms(pipeline: SlamPipeline, maps: Sequence[SlamPipeline], shifts: list[Shift]) -> None:
    """All rooms, doors and gaps under new numbers; the robot is in the room of the first map."""
    rooms, doors = pipeline.rooms, list[Door]()
    rooms.rooms.clear()
    for one, shift in zip(maps, shifts, strict=True):
        rooms.rooms += [room + shift.room for room in one.rooms.rooms]
        rooms.merged |= {old + shift.room: new + shift.room for old, new in one.rooms.merged.items()}
        doors += map(shift.doorway, one.rooms.door_map.doors)
        rooms.door_map.candidates += map(shift.candidate, one.rooms.door_map.candidates)
        rooms.door_map.sightings |= {shift.ids(pair): n for pair, n in one.rooms.door_map.sightings.items()}
    rooms.door_map.set_doors(doors)
    rooms.door_map.next_id = shifts[-1].door + maps[-1].rooms.door_map.next_id
    rooms.next_room = shifts[-1].room + maps[-1].rooms.next_room
    rooms.current = maps[0].rooms.current
    pipeline.map.polygons.prune(pipeline.map.features, rooms.resolve)
