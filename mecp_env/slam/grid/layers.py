"""What is painted on the canvas: key scans, known polygons, doors. Each can be moved to where its landmarks are."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from mecp_env.core.carriers import Array, Bools, Ints
from mecp_env.core.se2 import wrapped
from mecp_env.slam.config import GridConfig
from mecp_env.slam.grid import cells, key_scans
from mecp_env.slam.grid.canvas import Canvas
from mecp_env.slam.messages import NO_ID, UNKNOWN_ROOM, Belief, MapPolygon, RoomGraph

IDS = attrgetter("ids")
KEY = attrgetter("id", "jambs", "other_face")  # a `DoorKey`

DoorKey = tuple[int, tuple[int, int], tuple[int, int] | None]


@dataclass(slots=True, eq=False)
class ScanLayer:
    """The key scans: row = scan, in order of time."""

    config: GridConfig
    T_map_robot: Array = field(default_factory=lambda: np.empty((0, 3)))  # (n,3) pose each is painted at
    room: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (n,) UNKNOWN_ROOM when taken in a doorway
    step: Ints = field(default_factory=lambda: np.empty(0, np.int64))  # (n,) when each was taken
    anchor: Ints = field(default_factory=lambda: np.empty((0, 0), np.int64))  # (n,k) landmark ids, NO_ID: none
    p_robot: Array = field(default_factory=lambda: np.empty((0, 0, 2)))  # (n,k,2) m, the anchors in the scan's frame
    outline: list[Array] = field(default_factory=list)  # (m,2) m, free space, robot frame
    strips: list[Array] = field(default_factory=list)  # (s,4,2) m, walls, robot frame
    has_room: Bools = field(default_factory=lambda: np.empty(0, np.bool_))  # (n,) its room is on the canvas

    def wants(self, T_map_robot: Array, room: int) -> bool:
        """True when no key scan of this room lies near."""
        x, y, _ = T_map_robot.tolist()
        near = key_scans.nearest_of_group(self.T_map_robot, self.room, room, x, y)
        return bool(near > self.config.key_scan_m)

    def add(self, canvas: Canvas, T_map_robot: Array, taken: tuple[int, int], seen: tuple[Array, Array]) -> None:
        """Paint a scan, `taken` in which room, in which step, of which outline and strips were `seen`.

        It has no anchors yet.
        """
        n, k, (room, step) = len(self.room), self.config.anchors, taken
        self.T_map_robot = np.concatenate([self.T_map_robot, T_map_robot[None]])
        self.room, self.step = np.append(self.room, room), np.append(self.step, step)
        self.has_room = np.append(self.has_room, room == UNKNOWN_ROOM)
        self.anchor = np.concatenate([self.anchor.reshape(n, k), np.full((1, k), NO_ID)])
        self.p_robot = np.concatenate([self.p_robot.reshape(n, k, 2), np.zeros((1, k, 2))])
        self.outline.append(seen[0])
        self.strips.append(seen[1])
        self._vote(canvas, n, 1)

    def painted_at(self, canvas: Canvas, T_map_robot: Array) -> ScanLayer:
        """The same key scans at other poses (n,3), painted on an empty canvas; their rooms are still to be painted."""
        moved = replace(self, T_map_robot=T_map_robot, has_room=self.room == UNKNOWN_ROOM)
        for row in range(len(T_map_robot)):
            moved._vote(canvas, row, 1)
        return moved

    def _vote(self, canvas: Canvas, row: int, delta: int) -> None:
        """Cast the votes of a scan (`delta` 1) or take them back (-1)."""
        canvas.vote(self.outline[row], self.strips[row], self.T_map_robot[row], delta)

    def anchor_to(self, p_landmark: Array, matched_ids: Ints, belief: Belief) -> None:
        """Anchor the scans without anchors at the most certain of the landmarks matched now."""
        scans = self.anchor, self.p_robot, self.T_map_robot
        key_scans.anchor_scans(*scans, p_landmark, matched_ids, belief.ids, belief.covs)

    def follow(self, canvas: Canvas, p_landmark: Array) -> None:
        """Move the scans whose landmarks moved by more than half a cell, drop those whose landmarks are gone."""
        poses, present = key_scans.anchored_poses(self.anchor, self.p_robot, self.T_map_robot, p_landmark)
        step = poses - self.T_map_robot
        shift, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(wrapped(step[:, 2]))
        moved = shift + self.config.paint_range_m * turn > 0.5 * canvas.resolution_m
        lost = (self.anchor[:, :1] != NO_ID).any(axis=1) & (present == 0)
        for row in np.flatnonzero(moved | lost).tolist():
            self._vote(canvas, row, -1)
        self.T_map_robot = np.where(moved[:, None], poses, self.T_map_robot)  # a new one: outputs hold the old
        for row in np.flatnonzero(moved & ~lost).tolist():
            self._vote(canvas, row, 1)
        self.has_room &= ~moved
        if lost.any():
            self._keep(~lost)

    def _keep(self, rows: Bools) -> None:
        """Forget the scans that `rows` (n,) does not name."""
        self.T_map_robot, self.room, self.step = self.T_map_robot[rows], self.room[rows], self.step[rows]
        self.anchor, self.p_robot, self.has_room = self.anchor[rows], self.p_robot[rows], self.has_room[rows]
        self.outline = [self.outline[row] for row in np.flatnonzero(rows)]
        self.strips = [self.strips[row] for row in np.flatnonzero(rows)]

    def part_rooms(self, parted: dict[int, tuple[int, int]]) -> None:
        """Give the scans that were taken in rooms entered unnoticed to those rooms, to be painted again."""
        for room, (taken_for, since) in parted.items():
            strays = (self.room == taken_for) & (self.step >= since)
            self.room, self.has_room = np.where(strays, room, self.room), self.has_room & ~strays

    def paint_rooms(self, canvas: Canvas, cuts: Array) -> None:
        """Write the room of the scans that have none on the canvas yet, as far as the lines `cuts` (d,2,2) let see."""
        rows = np.flatnonzero(~self.has_room).tolist()
        lines, layer = canvas.to_cells(cuts) if rows else cuts, canvas.layers[cells.ROOM]
        for row in rows:
            scan = self.outline[row], self.strips[row], self.T_map_robot[row]
            cells.paint_room(layer, int(self.room[row]), *scan, lines, canvas.raster)
        self.has_room[:] = True

    def forget_behind(self, canvas: Canvas, cuts: Array) -> None:
        """Take the room off what was seen, as far as is painted, through doors (d,2,2) m that were not known then."""
        lines, offset = canvas.to_cells(cuts), self.T_map_robot[:, None, :2] - cuts.mean(axis=1)
        near = (np.hypot(offset[:, :, 0], offset[:, :, 1]) < self.config.paint_range_m).any(axis=1)
        layer = canvas.layers[cells.ROOM]
        for row in np.flatnonzero(near & self.has_room & (self.room != UNKNOWN_ROOM)).tolist():
            room, outline, T_map_robot = int(self.room[row]), self.outline[row], self.T_map_robot[row]
            cells.forget_room(layer, room, outline, T_map_robot, lines, canvas.raster)


@dataclass(slots=True, eq=False)
class PaintedPolygon:
    """A known polygon as it stands on the grid."""

    ring: Array  # (k,2) m, map frame
    room: int  # before merges


@dataclass(slots=True, eq=False)
class PolygonLayer:
    """The interiors of the known polygons: the paper's layer."""

    painted: dict[tuple[int, ...], PaintedPolygon] = field(default_factory=dict)  # by vertex ids
    waiting: list[MapPolygon] = field(default_factory=list)  # with a vertex that is not a landmark yet
    known: tuple[MapPolygon, ...] = ()  # the polygons looked at last

    def compare(self, canvas: Canvas, known: tuple[MapPolygon, ...]) -> None:
        """Take off what is no longer known; what is new waits to be painted."""
        rings = {tuple(polygon.ids.tolist()): polygon for polygon in known}
        for ids in self.painted.keys() - rings.keys():
            self._stamp(canvas, self.painted.pop(ids), -1)
        self.waiting = [polygon for ids, polygon in rings.items() if ids not in self.painted]
        self.known = known

    def paint_waiting(self, canvas: Canvas, p_landmark: Array) -> None:
        """Paint those that wait and now have landmarks at all their vertices."""
        still: list[MapPolygon] = []
        for polygon in self.waiting:
            if polygon.ids.max() >= len(p_landmark) or np.isnan(p_landmark[polygon.ids]).any():
                still.append(polygon)
                continue
            painted = PaintedPolygon(p_landmark[polygon.ids], polygon.room)
            self.painted[tuple(polygon.ids.tolist())] = painted
            self._stamp(canvas, painted, 1)
        self.waiting = still

    def follow(self, canvas: Canvas, p_landmark: Array) -> None:
        """Move the polygons of which a vertex moved by more than half a cell."""
        if not self.painted:
            return
        keys = list(self.painted)
        first = np.cumsum([0, *map(len, keys[:-1])])
        ids = np.array([i for key in keys for i in key], np.int64)
        rings = np.concatenate([polygon.ring for polygon in self.painted.values()])
        moves = p_landmark[ids] - rings
        shifts = np.fmax.reduceat(np.hypot(moves[:, 0], moves[:, 1]), first)
        for row in np.flatnonzero(shifts > 0.5 * canvas.resolution_m):
            polygon = self.painted[keys[row]]
            self._stamp(canvas, polygon, -1)
            polygon.ring = p_landmark[list(keys[row])]
            self._stamp(canvas, polygon, 1)

    def rename_rooms(self, canvas: Canvas, graph: RoomGraph) -> None:
        """Write the rooms again after a merge."""
        for polygon in self.painted.values():
            polygon.room = graph.resolve(polygon.room)
            canvas.set_room(polygon.ring, polygon.room)

    def _stamp(self, canvas: Canvas, polygon: PaintedPolygon, delta: int) -> None:
        """Paint a polygon (`delta` 1) or take it off (-1)."""
        canvas.stamp(polygon.ring[None], cells.COVER, delta, polygon.room)


@dataclass(slots=True, eq=False)
class DoorLayer:
    """The cells between the jambs of the doors, and the lines that part the rooms."""

    config: GridConfig
    key: tuple[DoorKey, ...] = ()  # the doors painted: id and jambs of both faces
    quads: Array = field(default_factory=lambda: np.empty((0, 4, 2)))  # (d,4,2) m, map frame, as painted
    lines: Array = field(default_factory=lambda: np.empty((0, 2, 2)))  # (c,2,2) m, across the known quads

    def update(self, canvas: Canvas, graph: RoomGraph, p_landmark: Array, moved: bool, voted: bool) -> Array:
        """Paint new doors, move those that moved by more than half a cell; the lines (d,2,2) of all that changed.

        `moved`: landmarks did; `voted`: a scan did. A door that a wall fills is not painted, as no path leads there.
        """
        key = tuple(map(KEY, graph.doors))
        if key == self.key and not moved and not (voted and self._may_open_or_shut(canvas)):
            return np.empty((0, 2, 2))
        quads = self._quads_of(p_landmark, key)
        quads[self._shut(canvas, quads, again=voted or key != self.key)] = np.nan
        rows = self._rows_of(key)
        still, same = (self._standing(rows, quads, limit) for limit in (0.5 * self.config.resolution_m, 0.0))
        if still.all() and len(key) == len(self.key):
            return np.empty((0, 2, 2))
        canvas.stamp(np.delete(self.quads, rows[same], axis=0), cells.DOOR, -1)
        canvas.stamp(quads[~same], cells.DOOR, 1)
        self.key, self.quads, self.lines = key, quads, self._cut_lines(quads)
        return self._cut_lines(quads[~still])

    def _shut(self, canvas: Canvas, quads: Array, again: bool) -> Bools:
        """(d,) the doors (d,4,2) m that a wall fills: by the votes of now (`again`), or as it was."""
        return canvas.are_walled_up(quads, self.config.occupied_ratio) if again else np.isnan(self.quads[:, 0, 0])

    def _may_open_or_shut(self, canvas: Canvas) -> bool:
        """True when a wall fills a door that is painted, and while one is not painted."""
        shut = np.isnan(self.quads).any() or canvas.are_walled_up(self.quads, self.config.occupied_ratio).any()
        return bool(shut)

    def _rows_of(self, key: tuple[DoorKey, ...]) -> Ints:
        """(d,) where each door is among those that are painted, or -1."""
        row = {door: i for i, door in enumerate(self.key)}
        return np.array([row.get(door, -1) for door in key], np.int64)

    def _standing(self, rows: Ints, quads: Array, limit: float) -> Bools:
        """(d,) True for each door that was painted before, in row `rows` (d,), within `limit` m of where it is now."""
        still = rows >= 0
        before, now = self.quads[rows[still]], quads[still]
        changed = (np.abs(before - now) > limit) | (np.isnan(before) != np.isnan(now))
        still[still] = ~changed.any(axis=(1, 2))
        return still

    def _quads_of(self, p_landmark: Array, doors: tuple[DoorKey, ...]) -> Array:
        """(d,4,2) m: of each door the right and left jamb, then the left and right one of the other face.

        With one face known the door is a cell deep, as walls are painted. It is deeper by half a cell on both sides, to
        join the floor.
        """
        jambs = np.array([(*face, *(other or face)) for _, face, other in doors], np.int64)
        faces = p_landmark[jambs.reshape(-1, 4)]
        depth = np.array([0.0 if other else self.config.resolution_m for _, _, other in doors], np.float64)
        along, rim = faces[:, 1] - faces[:, 0], 0.5 * self.config.resolution_m
        share = along / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        onward = np.stack((share[:, 1], -share[:, 0]), axis=1)[:, None]
        quads: Array = faces.take((0, 1, 3, 2), axis=1)
        quads[:, :2] += -rim * onward
        quads[:, 2:] += depth[:, None, None] * onward
        quads[:, 2:] += rim * onward
        return quads

    def cuts(self, graph: RoomGraph) -> Array:
        """(d,2,2) m, the lines that part the rooms: through the middle of each door, and across each candidate."""
        if not graph.candidates:
            return self.lines
        return np.concatenate([self.lines, self._widened(np.array([candidate.ends for candidate in graph.candidates]))])

    def _cut_lines(self, quads: Array) -> Array:
        """(d,2,2) m: the line through the middle of each door (d,4,2) whose jambs are in the map, a little widened."""
        known = quads[np.isfinite(quads).all(axis=(1, 2))]
        return self._widened(0.5 * (known[:, :2] + known[:, 3:1:-1]))

    def _widened(self, lines: Array) -> Array:
        """Lines (d,2,2) m, longer by a cell at both ends: a door cuts the sight a little beyond its jambs."""
        along = lines[:, 1] - lines[:, 0]
        side = self.config.resolution_m * along / np.maximum(np.hypot(along[:, :1], along[:, 1:]), 1e-9)
        return np.stack([lines[:, 0] - side, lines[:, 1] + side], axis=1)
