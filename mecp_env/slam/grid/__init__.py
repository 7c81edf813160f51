"""The semantic grid: cells with a label, a room and the paper's polygon layer, painted from the belief.

Everything can be rendered again: a key scan is anchored at landmarks, a polygon at its vertices, a door at its jambs.
When one of them moves by more than half a cell, its votes are taken off the grid and cast again at the new place.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from operator import is_

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.slam.config import GridConfig
from mecp_env.slam.grid import cells, key_scans
from mecp_env.slam.grid.canvas import Canvas, empty_grid
from mecp_env.slam.grid.layers import IDS, DoorLayer, PolygonLayer, ScanLayer
from mecp_env.slam.messages import UNKNOWN_ROOM, Belief, MapPolygon, MergedScan, RoomGraph, Segments, SemanticGrid


class GridPainter:
    """Paints a `SemanticGrid`, once a step; every attribute is plain state.

    A cell is OCCUPIED when at least `occupied_ratio` of the key scans that say something about it found a wall there,
    FREE when they looked through it, DOOR between the jambs of a door, OCCUPIED too when it is an unknown pocket of a
    completed room, else UNKNOWN.
    """

    completed: tuple[int, ...]  # rooms with nothing left to see
    filled: tuple[int, ...]  # those whose pockets are painted

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.canvas = Canvas(config.resolution_m, empty_grid(config.resolution_m))
        self.scans = ScanLayer(config)
        self.polygons = PolygonLayer()
        self.doors = DoorLayer(config)
        self.p_landmark = np.empty((0, 2))  # (F,2) m by id, nan: none; where they were at the last look
        self.merges = 0
        self.partings = 0
        self.step = 0  # how often it painted
        self.completed = ()
        self.filled = ()
        self.again = False  # the next scan is painted, wherever it is taken

    def paint(
        self,
        belief: Belief,
        beams: MergedScan,
        segments: Segments,
        matched_ids: Ints,
        map_polygons: Sequence[MapPolygon],
        graph: RoomGraph,
    ) -> SemanticGrid:
        """The grid after this step. `matched_ids` (n,): the landmarks this scan was matched to."""
        self.step += 1
        p_landmark, change = self._look(belief)
        self._update_polygons(p_landmark, tuple(map_polygons), change)
        self._follow(p_landmark, graph, change)
        self._add_key_scan(belief, beams, segments, graph)
        self.scans.anchor_to(p_landmark, matched_ids, belief)
        if np.count_nonzero(self.scans.has_room) < len(self.scans.has_room):
            self.scans.paint_rooms(self.canvas, self.doors.cuts(graph))
        self._update_pockets(graph)
        return self.canvas.publish(self.config.occupied_ratio)

    def complete(self, rooms: Collection[int]) -> None:
        """Mark the rooms with nothing left to see: from the next step on their unknown pockets are walls."""
        self.completed = tuple(sorted(rooms))

    def finish(self, graph: RoomGraph) -> SemanticGrid:
        """The grid of this step with the pockets of rooms just marked as complete: there may be no next step."""
        self._update_pockets(graph)
        return self.canvas.publish(self.config.occupied_ratio)

    def redrawn(self, belief: Belief, T_map_laser: Array, graph: RoomGraph) -> SemanticGrid:
        """The grid with the key scans at poses (n,3) and the landmarks of `belief`; this painter stays as it is."""
        again = GridPainter(self.config)
        p_landmark, _ = again._look(belief)
        again.scans = self.scans.painted_at(again.canvas, T_map_laser)
        again.polygons.compare(again.canvas, self.polygons.known)
        again.polygons.paint_waiting(again.canvas, p_landmark)
        again.polygons.rename_rooms(again.canvas, graph)
        again.doors.update(again.canvas, graph, p_landmark, moved=True, voted=True)
        again.scans.paint_rooms(again.canvas, again.doors.cuts(graph))
        again.complete(self.completed)
        return again.finish(graph)

    def look_again(self) -> None:
        """Paint the next scan though others were taken near it: dynamic objects there may have gone."""
        self.again = True

    def _look(self, belief: Belief) -> tuple[Array, int]:
        """Where the landmarks are (F,2), and what happened to them since the last look (`key_scans.MOVED`, ...)."""
        limit = 0.25 * self.config.resolution_m
        p_landmark, change = key_scans.compare_landmarks(belief.ids, belief.p_map, self.p_landmark, limit)
        if change & (key_scans.MOVED | key_scans.WENT):
            self.p_landmark = p_landmark
        elif change & key_scans.CAME:
            before = np.full_like(p_landmark, np.nan)
            before[: len(self.p_landmark)] = self.p_landmark
            self.p_landmark = np.where(np.isnan(before), p_landmark, before)
        return p_landmark, change

    def _update_polygons(self, p_landmark: Array, known: tuple[MapPolygon, ...], change: int) -> None:
        """Bring the polygons on the grid in line with the known ones."""
        old = self.polygons.known  # a polygon seen again is a new one with the ids of the old
        same = len(known) == len(old) and all(map(is_, map(IDS, known), map(IDS, old)))
        differs = not same or bool(change & key_scans.WENT)
        if differs:
            self.polygons.compare(self.canvas, known)
        if differs or change & key_scans.CAME:
            self.polygons.paint_waiting(self.canvas, p_landmark)

    def _follow(self, p_landmark: Array, graph: RoomGraph, change: int) -> None:
        """Paint again what moved, what merged or was parted, and what lies behind a new door."""
        moved = bool(change & (key_scans.MOVED | key_scans.WENT))
        if moved:
            self.scans.follow(self.canvas, p_landmark)
            self.polygons.follow(self.canvas, p_landmark)
        if len(graph.parted) != self.partings:
            self.partings = len(graph.parted)
            self.scans.part_rooms(graph.parted)
        voted = len(self.scans.step) > 0 and bool(self.scans.step[-1] == self.step - 1)
        new_doors = self.doors.update(self.canvas, graph, p_landmark, moved, voted)
        if len(new_doors):
            self.scans.forget_behind(self.canvas, new_doors)
        if len(graph.merged) != self.merges:
            self._rename_rooms(graph)

    def _rename_rooms(self, graph: RoomGraph) -> None:
        """Give merged rooms their new name everywhere."""
        self.merges = len(graph.merged)
        rooms = self.canvas.layers[cells.ROOM]
        for room in graph.merged:
            rooms[rooms == room] = graph.resolve(room)
        self.scans.room = np.array([graph.resolve(int(room)) for room in self.scans.room], np.int64)
        self.polygons.rename_rooms(self.canvas, graph)
        self.canvas.everything_dirty()

    def _add_key_scan(self, belief: Belief, beams: MergedScan, segments: Segments, graph: RoomGraph) -> None:
        """Paint this scan when no key scan of the room lies near."""
        pose = belief.T_map_robot
        room = UNKNOWN_ROOM if graph.in_doorway else graph.resolve(graph.current)
        if self.again or self.scans.wants(pose, room):
            self.again = False
            seen = key_scans.free_and_walls(beams, segments, self.config)
            self.scans.add(self.canvas, pose.copy(), (room, self.step), seen)

    def _update_pockets(self, graph: RoomGraph) -> None:
        """Turn unknown pockets of completed rooms into walls, when other rooms are complete than before."""
        if self.completed == self.filled and graph.merged.keys().isdisjoint(self.completed):
            return
        completed = tuple(sorted({graph.resolve(room) for room in self.completed}))
        if completed == self.filled:
            return
        flags = np.zeros(max(completed, default=-1) + 1, np.bool_)
        flags[list(completed)] = True
        self.canvas.fill_pockets(flags, self.config.occupied_ratio, self.scans.T_map_robot[:, :2])
        self.filled = completed
