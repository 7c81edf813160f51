"""The front end (III-A.1): dense scan, data clustering, segments, corners; in one compiled call where possible."""

from __future__ import annotations

from mecp_env.core.carriers import Array, Bools, Ints, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.sensors import Scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend.clustering import (
    beams_on_walls,
    cluster_beams,
    find_clusters,
    threshold_rule,
    wall_beams,
)
from mecp_env.slam.frontend.corners import Found, as_corners, extract_corners, find_corners
from mecp_env.slam.frontend.scan import average_sweeps, merge_sweeps, restore_lost_beams, stop_at_walls
from mecp_env.slam.frontend.segments import extract_segments, find_segments
from mecp_env.slam.messages import MergedScan, ScanFeatures, Segments


def front_end(scan: Scan, config: SlamConfig) -> ScanFeatures:
    """The features of a scan. A laser that loses beams, and the union of sweeps, take the stages one by one."""
    rule, sensor = config.clustering, config.sensor
    if sensor.dark_dropout > 0.0 or sensor.grazing_deg < 90.0 or rule.sweeps == "union":
        return stage_by_stage(scan, config)
    beams, segments, found, wall = find_features(
        (scan.ranges, scan.bearings, scan.hit),
        scan.max_range_m,
        threshold_rule(rule, sensor),
        config.segments.record,
        config.corners.record,
        config.corners.gaps.record,
        sensor.record,
    )
    merged = MergedScan(*beams[:4], scan.max_range_m, *beams[4:])
    return ScanFeatures(merged, Segments(*segments), as_corners(found, config.corners, sensor), wall)


def stage_by_stage(scan: Scan, config: SlamConfig) -> ScanFeatures:
    """The same features of the same scan, in the order of the paper."""
    rule, sensor, united = config.clustering, config.sensor, config.clustering.united(len(scan.ranges))
    beams = restore_lost_beams(merge_sweeps(scan, sensor, rule.sweeps), sensor)  # dense scan
    clusters = cluster_beams(beams, rule, config.segments, sensor, united)  # data clustering
    segments = extract_segments(beams, clusters, config.segments, sensor)  # Ramer-Douglas-Peucker
    beams = stop_at_walls(beams, segments, sensor)
    corners = extract_corners(beams, segments, config.corners, sensor)  # line intersections, ends
    return ScanFeatures(beams, segments, corners, beams_on_walls(clusters, beams))


@compiled
def find_features(
    sweeps: tuple[Array, Array, Bools],
    max_range: float,
    rule: tuple[float, float, float],
    segment_config: Rows,
    corner_config: Rows,
    gap_config: Rows,
    sensor: Rows,
) -> tuple[
    tuple[Array, Array, Bools, Ints, Array, Array],
    tuple[Array, Array, Array, Ints, Ints, Ints, int],
    Found,
    Bools,
]:
    """The arrays of `MergedScan`, the fields of `Segments`, what `find_corners` returns, and the beams on walls."""
    ranges, bearings, hit, count, raw_ranges, raw_bearings = average_sweeps(
        sweeps[0], sweeps[1], sweeps[2], max_range, sensor
    )
    scan = ranges, bearings, hit, count
    roll, runs = find_clusters(scan, rule, segment_config, sensor)
    clusters = runs[0], runs[1], runs[2]
    points, line, cov, spans = find_segments((ranges, bearings, count), clusters, roll, segment_config, sensor)
    cluster, first, last = spans[0], spans[1], spans[2]
    beams = ranges, bearings, count, hit, raw_ranges, raw_bearings
    lines = points, line, cov, cluster, first, last
    found = find_corners(beams, lines, roll, max_range, corner_config, gap_config, sensor)
    wall = wall_beams(roll, runs[0], runs[1], runs[2], ranges.shape[0])
    whole = ranges, bearings, hit, count, raw_ranges, raw_bearings
    return whole, (points, line, cov, cluster, first, last, roll), found, wall
