"""The paper's figures 2 to 8 from our own run on the layout `paper`, as PNG and SVG, and what each of them shows.

One exploration with the paper's noise (seed 0), and the default estimator on it. Figures 2 and 3 are the scan among the
first that sees the longest stretches of wall at a glancing angle; 4 is the recognised polygon with most vertices; 5 is
the map just before the third room; 6 and 8 are the map at the end; 7 is the building. Ellipses are of 95 %, magnified
as their legends say.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks import paper_plots
from benchmarks.common import Figures, Options
from benchmarks.drives import Drive
from benchmarks.paper_plots import Centre, in_the_map, in_the_scan
from benchmarks.records import Course, Records
from benchmarks.tables import flatten, sections, table
from mecp_env.core.carriers import Array, Ints
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.evaluation.metrics import AssociationLog
from mecp_env.floorplans.plan_view import floor_plan
from mecp_env.render.plan_figures import plans_figure
from mecp_env.render.screen import map_picture
from mecp_env.render.shapes import SceneView
from mecp_env.slam import Scan, SlamOutput, SlamPipeline
from mecp_env.world.layout import load_layout

LAYOUT, SEED = "paper", 0
TITLES = {
    "fig2": "one sweep of the laser",
    "fig3": "the dense scan: four sweeps",
    "fig4": "mean of Gaussians of a polygon",
    "fig5": "polygons of the first two rooms",
    "fig6": "the hierarchy of data association",
    "fig7": "the environment",
    "fig8": "the map of EKF-SLAM with MECP association",
}
FIRST_SCANS = 120  # figures 2 and 3 are of one of these
NEAR_WALL_M, SPARSE_M, LEAST_HITS = 0.2, 0.12, 6  # of a face: hits that belong to it, and what spacing is sparse
MARGIN_M = 1.0  # around nearly all hits
FIRST_ROOMS = 2  # of figure 5


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """All that the figures show."""

    drive: Drive
    outputs: list[SlamOutput]
    scan: int  # of figures 2 and 3
    sparse: list[Array]  # (2,2) m, world: stretches of wall there that one sweep hits seldom
    centres: dict[str, Centre]  # of figure 4: in the scan and in the map
    early: int  # the scan of figure 5
    identity: Ints  # (F,) true corner of each feature


def run(options: Options) -> Figures:
    """The numbers of every figure."""
    shown = gather(options.records)
    outline = shown.drive.truth.outline
    return {
        "fig2": hits_of(shown, slice(0, 1)),
        "fig3": hits_of(shown, slice(None)),
        "fig4": {where: of_centre(centre) for where, centre in shown.centres.items()},
        "fig5": {"scans": shown.early, **polygons_of(shown.outputs[shown.early])},
        "fig6": polygons_of(shown.outputs[-1]),
        "fig7": {"rooms": len(outline.rooms), "doors": len(outline.doors.width)},
        "fig8": errors_of(shown),
    }


def pictures(options: Options) -> dict[str, Figure]:
    """The figures by name."""
    shown = gather(options.records)
    at, scan = shown.drive.T_world_robot[shown.scan], shown.drive.scans[shown.scan]
    dense = to_map(at, points_of(scan, slice(None)))
    limits = np.percentile(dense, 1.0, axis=0) - MARGIN_M, np.percentile(dense, 99.0, axis=0) + MARGIN_M
    final = view_of(shown, len(shown.outputs) - 1)
    return {
        "fig2": paper_plots.scan_figure(at, to_map(at, points_of(scan, slice(0, 1))), shown.sparse, limits),
        "fig3": paper_plots.scan_figure(at, dense, shown.sparse, limits),
        "fig4": paper_plots.centre_figure(shown.centres),
        "fig5": paper_plots.hierarchy_figure(view_of(shown, shown.early)),
        "fig6": paper_plots.hierarchy_figure(final),
        "fig7": plans_figure([floor_plan(load_layout(LAYOUT))]),
        "fig8": paper_plots.whole(map_picture(final)),
    }


def view_of(shown: Shown, step: int) -> SceneView:
    """What is known after a scan."""
    poses = np.array(shown.drive.T_world_robot[: step + 1])
    path = np.array([output.belief.T_map_robot[:2] for output in shown.outputs[: step + 1]])
    segments = shown.drive.truth.outline.segments
    return SceneView(segments, poses[-1], poses[0], poses[:, :2], path, shown.outputs[step], title=LAYOUT)


@cache
def gather(records: Path | None) -> Shown:
    """The drive, the estimator's outputs, and which of them the figures show."""
    drive = Records(records).drive(Course(LAYOUT, SEED))
    pipeline, log = SlamPipeline(drive.slam), AssociationLog(len(drive.truth.outline.corners))
    outputs = []
    for output, T_world_robot in drive.outputs(pipeline):
        outputs.append(output)
        log.record(output, drive.truth.identify(output.corners, T_world_robot))
    chosen = max(range(FIRST_SCANS), key=lambda step: length_of(sparse_stretches(drive, step)))
    early = next(k for k, output in enumerate(outputs) if len(output.graph.rooms) > FIRST_ROOMS) - 1
    sparse = sorted(sparse_stretches(drive, chosen), key=lambda ends: -length_of([ends]))[:3]
    return Shown(drive, outputs, chosen, sparse, recognised_polygon(outputs, pipeline), early, log.features[:, 0])


def points_of(scan: Scan, sweeps: slice) -> Array:
    """Hits (n,2) m of some sweeps, in the robot's frame."""
    hit = scan.hit[sweeps]
    return polar_to_points(np.column_stack([scan.ranges[sweeps][hit], scan.bearings[sweeps][hit]]))


def sparse_stretches(drive: Drive, step: int) -> list[Array]:
    """Ends (2,2) m, world, of the stretches of wall that the first sweep of a scan hits with a wide spacing."""
    points = to_map(drive.T_world_robot[step], points_of(drive.scans[step], slice(0, 1)))
    found = []
    for start, end in drive.truth.outline.segments:
        along, near = hits_along(points, start, end)
        if len(near) >= LEAST_HITS and (near[-1] - near[0]) / (len(near) - 1) > SPARSE_M:
            found.append(np.array([start + near[0] * along, start + near[-1] * along]))
    return found


def hits_along(points: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """The direction of a wall, and where (n,) m along it those of the points are that belong to it, in order."""
    along, length = (end - start) / np.linalg.norm(end - start), np.linalg.norm(end - start)
    s, off = (points - start) @ along, (points - start) @ np.array([-along[1], along[0]])
    return along, np.sort(s[(abs(off) < NEAR_WALL_M) & (s >= 0.0) & (s <= length)])


def length_of(stretches: list[Array]) -> float:
    """Their total length, m."""
    return float(sum(np.linalg.norm(b - a) for a, b in stretches))


def recognised_polygon(outputs: list[SlamOutput], pipeline: SlamPipeline) -> dict[str, Centre]:
    """The recognised polygon with most vertices, in its scan and in the final map."""
    seen = [
        (output, polygon.corners, output.match.ids[polygon.corners])
        for output in outputs
        for polygon in output.polygons
        if output.match.polygon >= 0
    ]
    known = [one for one in seen if all(pipeline.filter.has(int(i)) for i in one[2])]
    output, corners, ids = max(known, key=lambda one: len(one[2]))
    return {"scan": in_the_scan(output.polygon_corners, corners), "map": in_the_map(pipeline.filter, ids)}


def hits_of(shown: Shown, sweeps: slice) -> Figures:
    """How many hits the scan has, and how many per metre of the sparse stretches."""
    points = to_map(shown.drive.T_world_robot[shown.scan], points_of(shown.drive.scans[shown.scan], sweeps))
    on, sparse_m = sum(len(hits_along(points, *ends)[1]) for ends in shown.sparse), length_of(shown.sparse)
    return {"hits": len(points), "sparse_m": sparse_m, "hits_per_m": on / sparse_m}


def of_centre(centre: Centre) -> Figures:
    """Standard deviations of vertices and centre."""
    vertex, middle = (1e3 * sigma for sigma in centre.sigmas_m)
    return {"vertices": len(centre.points), "vertex_mm": vertex, "centre_mm": middle, "share": centre.variance_share}


def polygons_of(output: SlamOutput) -> Figures:
    """Rooms, doors, polygons of landmarks, and the vertices that polygons of different rooms share."""
    found = paper_plots.by_room(output)
    vertices = [{int(i) for polygon in polygons for i in polygon.ids} for polygons in found.values()]
    return {
        "rooms": len(output.graph.rooms),
        "rooms_with_polygons": len(found),
        "doors": len(output.graph.doors),
        "polygons": sum(map(len, found.values())),
        "shared_vertices": sum(len(a & b) for k, a in enumerate(vertices) for b in vertices[:k]),
    }


def errors_of(shown: Shown) -> Figures:
    """Landmarks of the final map, their error, and the length of the path."""
    belief, corners = shown.outputs[-1].belief, shown.drive.truth.outline.corners
    true = shown.identity[belief.ids]
    offset = to_map(shown.drive.T_world_robot[0], belief.p_map)[true >= 0] - corners.p_world[true[true >= 0]]
    steps = np.diff(np.array(shown.drive.T_world_robot)[:, :2], axis=0)
    return {
        "landmarks": len(belief.ids),
        "rmse_mm": 1e3 * float(np.sqrt((offset**2).sum(axis=1).mean())),
        "path_m": float(np.hypot(*steps.T).sum()),
    }


def report(figures: Figures) -> str:
    """The pictures, each with its numbers."""
    parts = {}
    for name, numbers in figures.items():
        below = table(["figure", "value"], flatten(numbers).items())
        parts[f"Figure {name[3:]}: {TITLES[name]}"] = f"![{TITLES[name]}](figures/{name}.png)\n\n{below}"
    return sections(parts)
