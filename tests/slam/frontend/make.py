"""The stages of the front end, one by one, from carrier to carrier."""

from mecp_env.slam.config import ClusteringConfig, SegmentConfig, SensorModel, SlamConfig
from mecp_env.slam.frontend.beams import BeamRuns, Beams, Pieces
from mecp_env.slam.frontend.clustering import beams_on_walls, cluster_beams
from mecp_env.slam.frontend.corners import extract_corners
from mecp_env.slam.frontend.scan import merge_sweeps, restore_lost_beams, stop_at_walls
from mecp_env.slam.frontend.segments import extract_segments
from mecp_env.slam.messages import Clusters, Corners, Doorways, MergedScan, Segments

PAPER = SensorModel()
PLAIN, SEGMENTS = ClusteringConfig(), SegmentConfig()


def front_end(scan, sensor=PAPER, config=None):
    """MergedScan, clusters, segments and corners of a scan."""
    config = config or SlamConfig()
    beams = merged(scan, sensor, config.clustering)
    found = clusters(beams, config.clustering, config.segments, sensor, config.clustering.united(len(scan.ranges)))
    pieces = extract_segments(Beams.of(beams), runs(found), config.segments.record, sensor.record)
    rules = config.corners.record, config.corners.gaps.record, sensor.record
    corners = extract_corners(Beams.of(beams), pieces, *rules)
    return beams, found, Segments(*pieces), Corners(*corners[:7], Doorways(*corners[7:]))


def merged(scan, sensor=PAPER, rule=PLAIN):
    """The dense scan."""
    rules = rule.record, sensor.record
    return MergedScan(*merge_sweeps(scan.ranges, scan.bearings, scan.hit, scan.max_range_m, *rules))


def restored(beams, sensor):
    """The dense scan with the beams that dark walls have swallowed."""
    return MergedScan(*restore_lost_beams(Beams.of(beams), sensor.record))


def stopped(beams, segments, sensor):
    """The dense scan whose lost beams end at walls."""
    return MergedScan(*stop_at_walls(Beams.of(beams), pieces_of(segments), sensor.record))


def clusters(beams, rule=PLAIN, segments=SEGMENTS, sensor=PAPER, sweeps=1):
    """The clusters of a dense scan."""
    return Clusters(*cluster_beams(Beams.of(beams), rule.record, segments.record, sensor.record, sweeps))


def on_walls(clusters, beams):
    """(B,) which beams are on clusters with lines."""
    return beams_on_walls(runs(clusters), len(beams.ranges))


def runs(clusters):
    """Clusters as the compiled functions take them."""
    return BeamRuns(clusters.roll, clusters.first, clusters.last, clusters.kind)


def pieces_of(segments):
    """Segments as the compiled functions take them."""
    spans = segments.cluster, segments.first, segments.last
    return Pieces(segments.points, segments.line, segments.cov, *spans, segments.roll)
