"""The front end (III-A.1): dense scan, data clustering, segments, corners."""

from mecp_env.core.sensors import Scan
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.frontend.clustering import beams_on_walls, cluster_beams
from mecp_env.slam.frontend.corners import extract_corners
from mecp_env.slam.frontend.scan import merge_sweeps, restore_lost_beams, stop_at_walls
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import ScanFeatures


def front_end(scan: Scan, config: SlamConfig) -> ScanFeatures:
    """The features of a scan, in the order of the paper."""
    rule, sensor, united = config.clustering, config.sensor, config.clustering.united(len(scan.ranges))
    beams = restore_lost_beams(merge_sweeps(scan, sensor, rule.sweeps), sensor)  # dense scan
    clusters = cluster_beams(beams, rule, config.segments, sensor, united)  # data clustering
    segments = extract_segments(beams, clusters, config.segments, sensor)  # Ramer-Douglas-Peucker
    beams = stop_at_walls(beams, segments, sensor)
    corners = extract_corners(beams, segments, config.corners, sensor)  # line intersections, ends
    return ScanFeatures(beams, segments, corners, beams_on_walls(clusters, beams))
