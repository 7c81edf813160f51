"""The paper's figures 2 to 8 with matplotlib: metres on both axes, legends, and no meaning in colour alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Rectangle
from scipy.spatial.distance import cdist

from benchmarks.polygon_centres import Centre
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import to_map
from mecp_env.render import shapes
from mecp_env.slam.messages import MapPolygon
from mecp_env.slam.output import SlamOutput
from mecp_env.world.outline import Outline, door_ring

TITLES = {
    "fig2": "one sweep of the laser",
    "fig3": "the dense scan: four sweeps",
    "fig4": "mean of Gaussians of a polygon",
    "fig5": "polygons of the first two rooms",
    "fig6": "the hierarchy of data association",
    "fig7": "the environment",
    "fig8": "the map of EKF-SLAM with MECP association",
}
GREEN, RED, BLUE, WALL = "#2e8b57", "#b2182b", "#2166ac", "0.75"
STYLES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)))
MARKS = "osD^vPX<>h*"
TONES = ("#4477aa", "#cc6677", "#117733", "#aa7700", "#88ccee", "#882255", "#44aa99", "#665533", "#332288")
WALL_M = 0.075  # half of a wall, which goes on outside
OFFSET_M = 0.5  # between the outer ends of a sparse stretch and its ellipse


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """The building, and where in it the map's frame is."""

    outline: Outline
    T_world_map: Array  # (3,)

    def place(self, p_map: Array) -> Array:
        """Points (n,2) of the map in the world, m."""
        return to_map(self.T_world_map, p_map)


def new_axes(width: float, height: float) -> tuple[Figure, Axes]:
    """A figure with one panel whose axes are in metres."""
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot()
    in_metres(axes)
    return figure, axes


def in_metres(axes: Axes) -> None:
    """Equal axes, named."""
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.2)


def add_legend(figure: Figure, columns: int = 4) -> None:
    """One legend below all panels."""
    figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def draw_walls(axes: Axes, segments: Array, label: str = "wall") -> None:
    """The faces of the building (S,2,2) as grey lines."""
    axes.add_collection(LineCollection(list(segments), colors=WALL, linewidths=1.2, label=label, zorder=0.5))
    axes.autoscale_view()


def draw_robot(axes: Axes, T_world_robot: Array, colour: str, label: str) -> None:
    """A triangle that points ahead, and its row in the legend."""
    marker = (3, 0, np.degrees(T_world_robot[2]) - 90.0)
    axes.plot(*T_world_robot[:2], marker=marker, markersize=11, color=colour, ls="")
    axes.plot([], [], "^", color=colour, markersize=9, label=label)


def scan_figure(T_world_robot: Array, p_world: Array, sparse: list[Array], limits: tuple[Array, Array]) -> Figure:
    """Hits (n,2) m of a scan, with ellipses around the sparse stretches of wall (the paper's figures 2 and 3)."""
    figure, axes = new_axes(8.6, 6.2)
    axes.plot(*p_world.T, ".", color="black", markersize=2.0, rasterized=True, label=f"{len(p_world):,} hits")
    draw_robot(axes, T_world_robot, BLUE, "robot")
    for number, (a, b) in enumerate(sparse):
        length, angle = float(np.linalg.norm(b - a)), float(np.degrees(np.arctan2(*(b - a)[::-1])))
        looks: dict[str, Any] = {"fill": False, "edgecolor": GREEN, "linewidth": 1.8, "linestyle": "--"}
        label = "wall seen at a glancing angle" if number == 0 else None
        axes.add_patch(Ellipse(tuple(0.5 * (a + b)), length + OFFSET_M, OFFSET_M, angle=angle, label=label, **looks))
    axes.set(xlim=(limits[0][0], limits[1][0]), ylim=(limits[0][1], limits[1][1]))
    add_legend(figure)
    return figure


def centre_figure(centres: Mapping[str, Centre]) -> Figure:
    """A polygon with the ellipses of its vertices and of its centre, once per frame (the paper's figure 4)."""
    figure = Figure(figsize=(9.5, 5.0), layout="constrained")
    titles = {"scan": "in one scan, robot frame", "map": "in the map, frame of the start"}
    for number, (axes, (where, centre)) in enumerate(zip(figure.subplots(1, 2), centres.items(), strict=True)):
        in_metres(axes)
        k, magnified = len(centre.points), magnification(centre)
        axes.add_collection(PolyCollection([centre.points], facecolors="none", edgecolors="black", linewidths=1.0))
        rings = [shapes.ellipse(p, cov, magnified) for p, cov in zip(centre.points, centre.blocks, strict=True)]
        axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=GREEN, linewidths=1.3))
        middle = shapes.ellipse(centre.mean, centre.mean_cov, magnified)
        axes.add_collection(
            PolyCollection([middle], facecolors="none", edgecolors=RED, linewidths=1.6, linestyles="--")
        )
        label = (lambda text: text) if number == 0 else (lambda text: None)
        axes.plot(*centre.points.T, "s", color=GREEN, markersize=4, label=label("vertex, 95 % ellipse (solid)"))
        axes.plot(*centre.mean, "o", color=RED, markersize=5, label=label("mean of Gaussians, 95 % ellipse (dashed)"))
        axes.margins(0.12)
        axes.autoscale_view()
        sigmas = "vertex {:.1f} mm, centre {:.1f} mm".format(*(1e3 * sigma for sigma in centre.sigmas_m))
        axes.set_title(f"{titles[where]}: {k} vertices\nsigma: {sigmas}; ellipses x {magnified:.0f}", fontsize=9)
    add_legend(figure)
    return figure


def magnification(centre: Centre) -> float:
    """How much larger the ellipses of a polygon are drawn, so that a vertex's is about a twelfth of its width."""
    wanted = float(np.ptp(centre.points, axis=0).max()) / 12.0 / (2.45 * centre.sigmas_m[0])
    return max((k for k in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0) if k <= wanted), default=1.0)


def whole_polygons(output: SlamOutput) -> list[MapPolygon]:
    """The polygons of the map whose vertices are all landmarks of the filter."""
    where = shapes.positions(output.belief)
    return [polygon for polygon in output.map_polygons if all(int(i) in where for i in polygon.ids)]


def rings_by_room(world: World, output: SlamOutput) -> dict[int, list[Array]]:
    """The polygons of landmarks (k,2) m, world, of each room of the map, those seen most often first."""
    where, whole = shapes.positions(output.belief), whole_polygons(output)
    found: dict[int, list[Array]] = {}
    for polygon in sorted(whole, key=lambda polygon: -polygon.seen):
        ring = world.place(np.array([where[int(i)] for i in polygon.ids]))
        found.setdefault(output.graph.resolve(polygon.room), []).append(ring)
    return found


def polygon_figure(world: World, output: SlamOutput) -> Figure:
    """The map's polygons, each with a line and a colour of its own (the paper's figure 5)."""
    figure, axes = new_axes(8.0, 6.0)
    draw_walls(axes, world.outline.segments)
    rooms = rings_by_room(world, output)
    for number, (room, rings) in enumerate(sorted(rooms.items())):
        for k, ring in enumerate(rings):
            closed = np.vstack([ring, ring[:1]])
            looks: dict[str, Any] = {"color": TONES[k % len(TONES)], "linewidth": 1.6, "alpha": 0.9}
            axes.plot(*closed.T, linestyle=STYLES[k % len(STYLES)], zorder=2.0 + 0.01 * k, **looks)
        corners = np.unique(np.vstack(rings).round(6), axis=0)
        label = f"vertex, room {room} ({len(rings)} polygons)"
        axes.plot(
            *corners.T, MARKS[number], color="black", markersize=6, markerfacecolor="white", label=label, zorder=4
        )
    axes.plot([], [], "-", color=TONES[0], label="polygons: one line style and colour each")
    every = np.vstack([ring for rings in rooms.values() for ring in rings])
    low, high = every.min(axis=0) - 0.8, every.max(axis=0) + 0.8
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    add_legend(figure, 2)
    return figure


def hierarchy_figure(world: World, output: SlamOutput) -> Figure:
    """Rooms, the polygons in each, and the doors that join them (the paper's figure 6)."""
    figure, axes = new_axes(9.5, 7.6)
    draw_walls(axes, world.outline.segments)
    rooms, middles = rings_by_room(world, output), dict[int, Array]()
    for number, (room, rings) in enumerate(sorted(rooms.items())):
        tone = TONES[number % len(TONES)]
        axes.add_collection(PolyCollection(rings, facecolors=light(tone), edgecolors="none", zorder=0.6))
        axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=tone, linewidths=0.8))
        largest = max(rings, key=lambda ring: float(np.ptp(ring, axis=0).prod()))
        points = np.unique(np.vstack(rings).round(6), axis=0)
        label = f"vertex of room {room}"
        axes.plot(*points.T, MARKS[number % len(MARKS)], color=tone, markersize=6, markeredgecolor="black", label=label)
        middles[room] = largest.mean(axis=0)
        said = f"room {room}\n{len(rings)} polygon{'s' * (len(rings) > 1)}\n{len(points)} vertices"
        white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
        x, y = middles[room].tolist()
        axes.text(x, y, said, ha="center", va="center", fontsize=9, zorder=6, bbox=white)
    draw_links(axes, world, output, middles)
    add_legend(figure, 5)
    return figure


def light(tone: str) -> tuple[float, float, float]:
    """A colour "#rrggbb", nearly white but opaque: areas that overlap do not add up."""
    red, green, blue = (0.85 + 0.15 * int(tone[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return red, green, blue


def draw_links(axes: Axes, world: World, output: SlamOutput, middles: dict[int, Array]) -> None:
    """A line from room to room through each door of the map."""
    where, lines, doors = shapes.positions(output.belief), [], []
    for door in output.graph.doors:
        ends = [middles.get(output.graph.resolve(room)) for room in door.rooms]
        if all(int(jamb) in where for jamb in door.jambs):
            at = world.place(np.array([where[int(jamb)] for jamb in door.jambs])).mean(axis=0)
            doors.append(at)
            lines += [np.array([end, at]) for end in ends if end is not None]
    axes.add_collection(
        LineCollection(lines, colors="black", linewidths=1.4, linestyles="--", zorder=5, label="rooms joined by a door")
    )
    axes.plot(*np.array(doors).T, "s", color="white", markeredgecolor="black", markersize=7, zorder=5.5, label="door")


def environment_figure(world: World) -> Figure:
    """The building: walls, rooms, doors (the paper's figure 7)."""
    outline = world.outline
    figure, axes = new_axes(9.5, 7.2)
    left, low, right, high = outline.bounds
    axes.add_patch(
        Rectangle(
            (left - WALL_M, low - WALL_M), right - left + 2 * WALL_M, high - low + 2 * WALL_M, color="0.3", label="wall"
        )
    )
    floor = [np.array(outline.free_area.exterior.coords)]
    axes.add_collection(PolyCollection(floor, facecolors="white", linewidths=0.0))
    solid = [np.array(ring.coords) for ring in outline.free_area.interiors]
    axes.add_collection(PolyCollection(solid, facecolors="0.3", linewidths=0.0))
    for name, room in zip(outline.room_names, outline.rooms, strict=True):
        x, y = shapely.maximum_inscribed_circle(room.intersection(outline.free_area), 0.05).coords[0]
        axes.text(x, y, name, ha="center", va="center", fontsize=10)
    along = np.column_stack([-np.sin(outline.doors.normal), np.cos(outline.doors.normal)])
    half = 0.5 * outline.doors.width[:, None] * along
    lines = np.stack([outline.doors.centre - half, outline.doors.centre + half], axis=1)
    axes.add_collection(LineCollection(list(lines), colors=RED, linewidths=2.5, linestyles=":", label="door, 0.9 m"))
    posts = np.concatenate([door_ring(outline.doors, door, 0.0) for door in range(len(outline.doors))])
    corners = outline.corners.p_world[cdist(outline.corners.p_world, posts).min(axis=1) > 1e-3]
    looks: dict[str, Any] = {"color": BLUE, "markerfacecolor": "white", "markersize": 5, "zorder": 4}
    axes.plot(*corners.T, "o", label=f"{len(corners)} corners that are no jambs", **looks)
    draw_robot(axes, world.T_world_map, GREEN, "start of the run of figures 2 to 8")
    axes.autoscale_view()
    axes.margins(0.02)
    add_legend(figure)
    return figure


def map_figure(world: World, output: SlamOutput) -> Figure:
    """Landmarks with their ellipses over the true walls (the paper's figure 8)."""
    belief = output.belief
    figure, axes = new_axes(9.5, 7.2)
    draw_walls(axes, world.outline.segments, "true wall")
    magnified = shapes.magnification(belief)
    pairs = zip(belief.p_map, belief.covs, strict=True)
    rings = [world.place(shapes.ellipse(mean, cov, magnified)) for mean, cov in pairs]
    label = f"95 % ellipse x {magnified:.0f}"
    axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=BLUE, linewidths=0.9, label=label))
    axes.plot(*world.place(belief.p_map).T, "+", color=RED, markersize=7, markeredgewidth=1.4, label="landmark")
    axes.autoscale_view()
    axes.margins(0.02)
    add_legend(figure)
    return figure
