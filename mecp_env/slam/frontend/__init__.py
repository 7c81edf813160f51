"""The front end (III-A.1): dense scan, data clustering, segments, corners."""

from mecp_env.core.carriers import Array, Bools, Rows
from mecp_env.core.jit import compiled
from mecp_env.core.sensors import Scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend.beams import Beams, Pieces
from mecp_env.slam.frontend.clustering import beams_on_walls, cluster_beams
from mecp_env.slam.frontend.corners import Found, extract_corners
from mecp_env.slam.frontend.scan import merge_sweeps, restore_lost_beams, stop_at_walls
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import Corners, Doorways, MergedScan, ScanFeatures, Segments

Rules = tuple[Rows, Rows, Rows, Rows, Rows]  # of clusters, segments, corners and gaps, and the laser


def front_end(scan: Scan, config: SlamConfig) -> ScanFeatures:
    """The beams of a scan, its straight segments, its corners, and which beams end on walls (III-A.1).

    Lengths in m, angles in rad, in the frame of the laser. The scan is not checked: `SlamPipeline` does.
    """
    corner_rules = config.corners.record, config.corners.gaps.record
    rules = config.clustering.record, config.segments.record, *corner_rules, config.sensor.record
    beams, segments, corners, wall = find_features(scan.ranges, scan.bearings, scan.hit, scan.max_range_m, rules)
    doorways = Doorways(*corners[7:])
    return ScanFeatures(MergedScan(*beams), Segments(*segments), Corners(*corners[:7], doorways), wall)


@compiled
def find_features(
    ranges: Array, bearings: Array, hit: Bools, max_range: float, rules: Rules
) -> tuple[Beams, Pieces, Found, Bools]:
    """Beams, segments, corners and beams on walls of sweeps (K,B), by all stages in the order of the paper."""
    clustering, segments, corners, gaps, sensor = rules
    united = ranges.shape[0] if clustering[0].is_union else 1
    beams = merge_sweeps(ranges, bearings, hit, max_range, clustering, sensor)  # dense scan
    beams = restore_lost_beams(beams, sensor)
    runs = cluster_beams(beams, clustering, segments, sensor, united)  # data clustering
    pieces = extract_segments(beams, runs, segments, sensor)  # Ramer-Douglas-Peucker
    beams = stop_at_walls(beams, pieces, sensor)
    found = extract_corners(beams, pieces, corners, gaps, sensor)  # line intersections, ends
    return beams, pieces, found, beams_on_walls(runs, beams.ranges.shape[0])
