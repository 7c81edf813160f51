"""The experiments of `claims`, one unit of work each: a drive, single scans against a map, single scans alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks import association, loop, variants
from benchmarks.common import Figures, estimate
from benchmarks.corner_scores import Preset, make_places, score_places
from benchmarks.drives import Drive
from benchmarks.features import SEED, THRESHOLDS, key_of, threshold
from benchmarks.paper_plots import in_the_map, in_the_scan
from benchmarks.records import IN_MEMORY, Records
from mecp_env.core.carriers import Array, Bools
from mecp_env.core.se2 import polar_to_points, to_map
from mecp_env.evaluation.ground_truth import covers
from mecp_env.lab.dobkin import rings_around
from mecp_env.slam import SlamConfig, SlamOutput, SlamPipeline
from mecp_env.slam.config import PolygonConfig
from mecp_env.slam.mecp import find_polygons
from mecp_env.slam.messages import Corners, Polygon

METHODS = variants.rows_of(  # some of the benchmark `association`
    *("mecp", "mecp without descriptor", "mecp without rooms", "mecp_paper", "nearest", variants.LETTER)
)
VARIANTS = variants.rows_of(  # of `loop`
    *("mecp", "mecp without polygons", "jcbb", "jcbb with descriptor", "mecp_paper")
)
SIGMAS = ((1.0, 10.0), (2.0, 20.0))
UNION = " of the union"
DENSE_SCANS = ("adaptive_noise", "adaptive", "adaptive_noise" + UNION, "adaptive" + UNION)
PRESETS: dict[Preset, Sequence[str]] = {
    (noise, sweeps): DENSE_SCANS if sweeps == 4 else THRESHOLDS for noise in ("paper", "ideal") for sweeps in (4, 1)
}
MATCHABLE = 4  # vertices
POINTS, INSIDE = 4, 0.95  # per polygon, drawn this share of the way from the robot to its edge, at most
UNCHECKED = PolygonConfig(check_walls=False)
KERNEL_SCANS = 5  # the kernel rule is tried in every fifth scan


def measure(unit: tuple[str, str, int], records: Records = IN_MEMORY) -> Figures:
    """What one unit measured: its kind, the layout, and a seed or a number of poses."""
    kind, layout, number = unit
    if kind == "scans":
        return of_scans(layout, number)
    if kind == "loop":
        return loop.on_drive(records.drive(loop.course(layout, number)), loop.SCANS, number, VARIANTS, SIGMAS)
    drive = records.drive(association.course(layout, number))
    methods = association.counted(drive, METHODS)
    if kind == "ideal":  # only the filter is told of noise
        return {"methods": methods}
    return {"methods": methods, "polygons": of_polygons(drive, np.random.default_rng(number))}


def of_polygons(drive: Drive, rng: np.random.Generator) -> Figures:
    """Sums over the scans of a drive; the share of the free area under polygons, and of rooms with one, at its end."""
    pipeline, shares = SlamPipeline(drive.slam), []
    sums = dict.fromkeys(("found", "unique", "lines", "free", "lines_raw", "free_raw", "searched", "lost", "none"), 0)
    for output, T_world_robot in drive.outputs(pipeline):
        if output.polygons and len(output.polygons[0].corners) >= MATCHABLE:
            sums["found"] += 1
            sums["unique"] += len(output.polygons) == 1
            shares.append(in_the_scan(output.corners, output.polygons[0].corners).variance_share)
        for name, count in (of_kernel(output.corners) if output.step % KERNEL_SCANS == 0 else {}).items():
            sums[name] += count
        raw = find_polygons(output.corners, output.beams, UNCHECKED)
        for suffix, polygons in (("", output.polygons), ("_raw", raw)):
            seen = lines_of_sight(drive, output, polygons, T_world_robot, rng)
            sums["lines" + suffix] += len(seen)
            sums["free" + suffix] += int(seen.sum())
    known = [p for p in output.map_polygons if all(pipeline.filter.has(int(i)) for i in p.ids)]
    cover, grid_cover = covers(drive.truth, output.grid, drive.T_world_robot[0])
    return {
        **sums,
        "share_in_scan": float(np.mean(shares)),
        "share_in_map": float(np.mean([in_the_map(pipeline.filter, p.ids).variance_share for p in known])),
        "cover": cover,
        "grid_cover": grid_cover,
        "rooms": len(output.graph.rooms),
        "rooms_with_polygon": len({output.graph.resolve(p.room) for p in known} & set(output.graph.rooms)),
    }


def of_kernel(corners: Corners) -> dict[str, int]:
    """Whether there is a polygon, and whether the paper's kernel rule loses vertices of the largest, or every one."""
    points = polar_to_points(corners.z[corners.sites])
    largest, by_rule = (
        max((ring.size for ring in rings_around(points, by_kernel)), default=0) for by_kernel in (False, True)
    )
    return {"searched": int(largest > 0), "lost": int(by_rule < largest), "none": int(by_rule == 0 < largest)}


def lines_of_sight(
    drive: Drive, output: SlamOutput, polygons: tuple[Polygon, ...], T_world_robot: Array, rng: np.random.Generator
) -> Bools:
    """Whether true walls leave the line free from each of a few points in the first polygon to each of its vertices.

    Only vertices that are true corners count, at their true places.
    """
    if not polygons:
        return np.empty(0, np.bool_)
    corners = output.corners
    ring, outline = polar_to_points(corners.z[polygons[0].corners]), drive.truth.outline
    true = drive.truth.identify(corners, T_world_robot)[polygons[0].corners]
    vertices = outline.corners.p_world[true[true >= 0]]
    points = to_map(T_world_robot, draw_inside(ring, rng))
    return np.concatenate([drive.truth.laser.visible(vertices, np.array([*point, 0.0])) for point in points])


def draw_inside(ring: Array, rng: np.random.Generator) -> Array:
    """Random points (n,2) of a polygon (k,2) around the origin, a little inside it, each triangle by its area."""
    following = np.roll(ring, -1, axis=0)
    areas = ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]
    chosen = rng.choice(len(ring), POINTS, p=areas / areas.sum())
    u, v = np.sort(rng.random((2, POINTS)), axis=0)
    return INSIDE * (u[:, None] * ring[chosen] + (v - u)[:, None] * following[chosen])


def of_scans(layout: str, poses: int) -> Figures:
    """Per preset and threshold the counts of every pose: detectable true corners that are found, and all of them."""
    places, counts = make_places(layout, poses, SEED, tuple(PRESETS)), Figures()
    for preset, names in PRESETS.items():
        counts[key_of(preset)] = {}
        for name in names:
            sweeps = "union" if UNION in name else "mean"
            rule = threshold(name.removesuffix(UNION)).model_copy(update={"sweeps": sweeps})
            # whatever noise a laser has, that of the paper is assumed
            scores = score_places(places, preset, SlamConfig(clustering=rule), assumed="paper")
            counts[key_of(preset)][name] = [[score.found[0], score.visible[0]] for score in scores]
    return counts


def recalls(counts: Sequence[Sequence[int]]) -> Array:
    """(n,) recall at each pose; nan where no corner is visible."""
    found, visible = np.array(counts, float).T
    return np.where(visible > 0, found / np.maximum(visible, 1.0), np.nan)


def of_clustering(single: dict[str, Array], dense: dict[str, Array]) -> Figures:
    """Recall with one sweep and with four, by threshold; differences at the same poses."""
    fixed = max((name for name in THRESHOLDS if name.startswith("fixed")), key=lambda n: np.nanmean(single[n]))
    return {
        "union_minus_single": estimate(dense["adaptive" + UNION] - single["adaptive"]),
        "union_with_noise_minus_single": estimate(dense["adaptive_noise" + UNION] - single["adaptive_noise"]),
        "mean_minus_single": estimate(dense["adaptive_noise"] - single["adaptive_noise"]),
        "adaptive_minus_fixed": estimate(single["adaptive"] - single[fixed]),
        "with_noise_minus_fixed": estimate(single["adaptive_noise"] - single[fixed]),
        "best_fixed": fixed,
        "recall": {name: estimate(values) for name, values in single.items()},
        "recall_dense": {name: estimate(values) for name, values in dense.items()},
    }
