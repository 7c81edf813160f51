"""The paper's figures 2 to 6 with matplotlib: metres on both axes, legends, and no meaning in colour alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy.linalg import block_diag

from mecp_env.core.carriers import Array, Bytes, Ints
from mecp_env.core.se2 import polar_to_points
from mecp_env.render import shapes
from mecp_env.render.palette import FREE, MARKERS, mix, room_colour, unit
from mecp_env.render.shapes import SceneView
from mecp_env.slam.messages import Corners, MapPolygon
from mecp_env.slam.output import SlamOutput
from mecp_env.slam.protocols import Filter

PICTURE_DPI = 100
GREEN, RED, BLUE = "#2e8b57", "#b2182b", "#2166ac"
OFFSET_M = 0.5  # between the outer ends of a sparse stretch and its ellipse
FRAMES = {"scan": "in one scan, robot frame", "map": "in the map, frame of the start"}


def whole(picture: Bytes) -> Figure:
    """A figure of a picture (height, width, 3) alone."""
    height, width, _ = picture.shape
    figure = Figure(figsize=(width / PICTURE_DPI, height / PICTURE_DPI), dpi=PICTURE_DPI)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(picture, aspect="auto")
    axes.set_axis_off()
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class Centre:
    """A polygon with the joint covariance of its vertices, and the Gaussian of its centre."""

    points: Array  # (k,2) m, vertices
    cov: Array  # (2k,2k) m^2, of all vertices

    @property
    def blocks(self) -> Array:
        """(k,2,2) m^2: the covariance of each vertex."""
        k = len(self.points)
        return self.cov.reshape(k, 2, k, 2)[np.arange(k), :, np.arange(k)]

    @property
    def mean(self) -> Array:
        """(2,) m: the centre (eq. 2)."""
        return self.points.mean(axis=0)

    @property
    def mean_cov(self) -> Array:
        """(2,2) m^2: covariance of the centre (eq. 3), all cross terms of the vertices included."""
        k = len(self.points)
        return self.cov.reshape(k, 2, k, 2).sum(axis=(0, 2)) / k**2

    @property
    def variance_share(self) -> float:
        """Variance of the centre over the mean variance of the vertices: 1/k where those are independent."""
        vertex, centre = self.sigmas_m
        return (centre / vertex) ** 2

    @property
    def sigmas_m(self) -> tuple[float, float]:
        """Standard deviation of a vertex (root mean square) and of the centre, m along one axis."""
        vertex = math.sqrt(np.trace(self.blocks, axis1=1, axis2=2).mean() / 2.0)
        return vertex, math.sqrt(np.trace(self.mean_cov) / 2.0)


def in_the_map(belief: Filter, ids: Ints) -> Centre:
    """The polygon of landmarks `ids` (k,), in the frame of the map."""
    mean, cov = belief.marginal(ids)
    return Centre(mean[3:].reshape(-1, 2), cov[3:, 3:])


def in_the_scan(corners: Corners, index: Ints) -> Centre:
    """The polygon of corners `index` (k,) of one scan, in the frame of the robot."""
    z, R = corners.measurements(index)
    J = block_diag(*([[np.cos(b), -r * np.sin(b)], [np.sin(b), r * np.cos(b)]] for r, b in z))
    return Centre(polar_to_points(z), J @ R @ J.T)


def panels(width: float, height: float, count: int = 1) -> tuple[Figure, list[Axes]]:
    """A figure with panels beside each other whose axes are in metres."""
    figure = Figure(figsize=(width, height), layout="constrained")
    all_axes = figure.subplots(1, count, squeeze=False)[0].tolist()
    for axes in all_axes:
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.2)
    return figure, all_axes


def add_legend(figure: Figure, columns: int = 4) -> Figure:
    """The figure with the legend of its first panel below all."""
    entries = figure.axes[0].get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    return figure


def draw_rings(axes: Axes, rings: list[Array], colour: Any, **looks: Any) -> None:
    """Outlines of polygons (k,2)."""
    axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=colour, **looks))


def scan_figure(T_world_robot: Array, p_world: Array, sparse: list[Array], limits: tuple[Array, Array]) -> Figure:
    """Hits (n,2) m of a scan, with ellipses around the sparse stretches of wall (the paper's figures 2 and 3)."""
    figure, (axes,) = panels(8.6, 6.2)
    axes.plot(*p_world.T, ".", color="black", markersize=2.0, rasterized=True, label=f"{len(p_world):,} hits")
    marker = (3, 0, np.degrees(T_world_robot[2]) - 90.0)
    axes.plot(*T_world_robot[:2], marker=marker, markersize=11, color=BLUE, ls="", label="robot")
    for a, b in sparse:
        length, angle = float(np.linalg.norm(b - a)), float(np.degrees(np.arctan2(*(b - a)[::-1])))
        looks: dict[str, Any] = {"fill": False, "edgecolor": GREEN, "linewidth": 1.8, "linestyle": "--"}
        axes.add_patch(Ellipse(tuple(0.5 * (a + b)), length + OFFSET_M, OFFSET_M, angle=angle, **looks))
    axes.plot([], [], "--", color=GREEN, label="wall seen at a glancing angle")
    axes.set(xlim=(limits[0][0], limits[1][0]), ylim=(limits[0][1], limits[1][1]))
    return add_legend(figure)


def centre_figure(centres: Mapping[str, Centre]) -> Figure:
    """A polygon with the ellipses of its vertices and of its centre, once per frame (the paper's figure 4)."""
    figure, both = panels(9.5, 5.0, 2)
    for axes, (where, centre) in zip(both, centres.items(), strict=True):
        magnified, vertices = magnification(centre), zip(centre.points, centre.blocks, strict=True)
        draw_rings(axes, [centre.points], "black", linewidths=1.0)
        draw_rings(axes, [shapes.ellipse(p, cov, magnified) for p, cov in vertices], GREEN, linewidths=1.3)
        middle = shapes.ellipse(centre.mean, centre.mean_cov, magnified)
        draw_rings(axes, [middle], RED, linewidths=1.6, linestyles="--")
        axes.plot(*centre.points.T, "s", color=GREEN, markersize=4, label="vertex, 95 % ellipse (solid)")
        axes.plot(*centre.mean, "o", color=RED, markersize=5, label="mean of Gaussians, 95 % ellipse (dashed)")
        axes.margins(0.12)
        axes.autoscale_view()
        sigmas = "vertex {:.1f} mm, centre {:.1f} mm".format(*(1e3 * sigma for sigma in centre.sigmas_m))
        title = f"{FRAMES[where]}: {len(centre.points)} vertices\nsigma: {sigmas}; ellipses x {magnified:.0f}"
        axes.set_title(title, fontsize=9)
    return add_legend(figure)


def magnification(centre: Centre) -> float:
    """How much larger the ellipses of a polygon are drawn, so that a vertex's is about a twelfth of its width."""
    wanted = float(np.ptp(centre.points, axis=0).max()) / 12.0 / (2.45 * centre.sigmas_m[0])
    return max((k for k in shapes.MAGNIFICATIONS if k <= wanted), default=1.0)


def by_room(output: SlamOutput) -> dict[int, list[MapPolygon]]:
    """The polygons of the map whose vertices are all landmarks of the filter, by room."""
    where, rooms = shapes.positions(output.belief), dict[int, list[MapPolygon]]()
    for polygon in output.map_polygons:
        if all(int(i) in where for i in polygon.ids):
            rooms.setdefault(output.graph.resolve(polygon.room), []).append(polygon)
    return dict(sorted(rooms.items()))


def hierarchy_figure(view: SceneView) -> Figure:
    """Rooms, the polygons in each, and the doors that join them (the paper's figures 5 and 6)."""
    figure, (axes,) = panels(9.5, 7.6)
    axes.add_collection(LineCollection(list(view.segments), colors="0.75", linewidths=1.2, label="wall", zorder=0.5))
    where, middles = shapes.positions(view.slam_output.belief), dict[int, Array]()
    for number, (room, polygons) in enumerate(by_room(view.slam_output).items()):
        rings = [view.to_world(np.array([where[int(i)] for i in polygon.ids])) for polygon in polygons]
        light = unit(mix(room_colour(room), FREE, 0.85))
        axes.add_collection(PolyCollection(rings, facecolors=light, edgecolors="none", zorder=0.6))
        draw_rings(axes, rings, unit(room_colour(room)), linewidths=0.8)
        middles[room] = max(rings, key=lambda ring: float(np.ptp(ring, axis=0).prod())).mean(axis=0)
        points = np.unique(np.vstack(rings).round(6), axis=0)
        looks: dict[str, Any] = {"color": unit(room_colour(room)), "markersize": 6, "markeredgecolor": "black"}
        axes.plot(*points.T, MARKERS[number % len(MARKERS)], ls="", label=f"vertex of room {room}", **looks)
        said = f"room {room}\n{len(rings)} polygon{'s' * (len(rings) > 1)}\n{len(points)} vertices"
        white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
        axes.text(*middles[room].tolist(), said, ha="center", va="center", fontsize=9, zorder=6, bbox=white)
    draw_links(axes, view, middles)
    axes.autoscale_view()
    return add_legend(figure, 5)


def draw_links(axes: Axes, view: SceneView, middles: Mapping[int, Array]) -> None:
    """A line from room to room through each door of the map."""
    where, graph = shapes.positions(view.slam_output.belief), view.slam_output.graph
    looks: dict[str, Any] = {"markeredgecolor": "black", "markersize": 7, "zorder": 5.5}
    for door in graph.doors:
        if all(int(jamb) in where for jamb in door.jambs):
            at = view.to_world(np.array([where[int(jamb)] for jamb in door.jambs])).mean(axis=0)
            rooms = [graph.resolve(room) for room in door.rooms]
            for end in (middles[room] for room in rooms if room in middles):
                axes.plot(*np.array([end, at]).T, "--", color="black", linewidth=1.4, zorder=5)
            axes.plot(*at, "s", color="white", **looks)
    axes.plot([], [], "--s", color="black", markerfacecolor="white", label="rooms joined by a door")
