"""Door posts that are no landmarks (IV): features for doors and rooms, left out of association and update."""

import numpy as np
import pytest

from mecp_env.slam.association import PostsApart
from mecp_env.slam.association.gating import MatchBuilder
from mecp_env.slam.config import AssociationConfig, FilterConfig, SlamConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.messages import UNKNOWN_ROOM, CornerKind, Decision, FeatureState, Reason
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make
from tests.slam.drives import Given

JAMB = int(CornerKind.JAMB)


def kinds(pipeline: SlamPipeline, ids: np.ndarray) -> np.ndarray:
    return pipeline.map.features.rows["kind"][ids]


@pytest.mark.parametrize("method", ["mecp", "mecp_paper", "nearest"])
def test_no_post_is_recognised_and_doors_are_found_all_the_same(drive, method):
    config = SlamConfig(association={"use_posts": False, "method": method})
    named, before = 0, np.empty(0, np.int64)
    for pipeline, output, _, _ in drive.run(config):
        found = output.match.recognised()
        assert (output.corners.kind[found] != JAMB).all()
        assert (before[output.associated.ids[output.associated.recognised()]] != JAMB).all()
        before = pipeline.map.features.rows["kind"].copy()  # this scan may have shown that a landmark is a post
        posts = output.match.ids[output.match.decision == int(Decision.PROVISIONAL)]
        named += int(np.isin(posts, output.belief.ids).sum())
    (door,) = output.graph.doors
    assert door.sightings > 20
    assert named > 50
    assert len(output.graph.rooms) == 2


def test_posts_in_the_filter_change_no_other_estimate(drive):
    """Removing all posts from the filter at the end of a drive, or never measuring them, is the same to the others."""
    *_, (pipeline, output, _, _) = drive.run(SlamConfig(association={"use_posts": False}))
    posts = output.belief.ids[kinds(pipeline, output.belief.ids) == JAMB]
    assert len(posts) >= 2
    pipeline.filter.remove(posts)
    after = pipeline.filter.belief()
    np.testing.assert_allclose(after.T_map_robot, output.belief.T_map_robot, atol=1e-9)
    np.testing.assert_allclose(after.pose_cov, output.belief.pose_cov, atol=1e-12)


def test_the_other_associator_sees_no_posts_and_its_decisions_come_back_for_the_right_corners():
    """Landmarks 1 and 3 are posts, corner 1 is one; a corner that is none is named only as a post."""
    points, R = np.array([(4.0, 3.0), (-3.0, 4.0), (-5.0, -2.0), (3.0, -4.0), (6.0, -1.0)]), 1e-4 * np.eye(10)
    estimate = make_filter(FilterConfig())
    estimate.augment(make.polar(points), R, np.arange(5))
    corners = make.corners(points=points, cov=R, kind=[0, JAMB, 0, 0, 0])
    table = make.features(5, state=FeatureState.LANDMARK, kind=[0, JAMB, 0, JAMB, 0])
    view = make.view(estimate.belief(), table, corners, make.graph(UNKNOWN_ROOM, ()), [(0, 2, 4), (0, 1, 2)])
    config, rings = AssociationConfig(use_posts=False, use_rooms=False, use_descriptor=False), [(0, 1, 2), (0, 2, 4)]

    def first_corner(seen, polygons, shown, belief):
        np.testing.assert_array_equal(seen.z, corners.z[[0, 2, 3, 4]])
        assert [polygon.corners.tolist() for polygon in polygons] == [[0, 1, 3]]
        assert shown.belief.ids.tolist() == belief.ids.tolist() == [0, 2, 4]
        assert shown.groups[3].ids.tolist() == [[0, 2, 4]]
        builder = MatchBuilder(4)
        builder.assign(0, Decision.LANDMARK, Reason.POLYGON, 0, 2.5)
        builder.polygon, builder.map_polygon = 0, 7
        return builder.match()

    match = PostsApart(Given(first_corner), config).associate(corners, tuple(map(make.polygon, rings)), view, estimate)
    assert (match.polygon, match.known, match.nis[0]) == (1, 7, 2.5)
    assert match.ids.tolist() == [0, 1, -1, 3, -1]
    named = [Decision.LANDMARK, Decision.PROVISIONAL, Decision.NEW, Decision.PROVISIONAL, Decision.NEW]
    assert match.decision.tolist() == named


@pytest.mark.parametrize("use_posts", [True, False])
def test_a_post_is_merged_only_as_a_landmark(use_posts):
    """To merge a post with a landmark would be an update by the post."""
    config = SlamConfig(association={"use_posts": use_posts}, filter={"kind": "riekf"})
    pipeline = SlamPipeline(config)
    z, R = np.array([[2.0, 0.1], [2.02, 0.1]]), np.diag([1e-3, 1e-4, 1e-3, 1e-4])
    twice = make.features(
        2, state=FeatureState.LANDMARK, convex=1, kind=(CornerKind.CROSSING, JAMB), normals=(0.3, 1.8)
    )
    ids = pipeline.map.features.append(twice.rows)
    pipeline.filter.augment(z, R, ids)
    seen = make.sighting(make.corners(z[:1], normals=0.3), make.match([0]), pipeline.filter.belief(), 5)
    after, merged = pipeline.map.merge(seen, pipeline.filter)
    assert merged == (((0, 1),) if use_posts else ())
    assert len(after.belief.ids) == 2 - use_posts
