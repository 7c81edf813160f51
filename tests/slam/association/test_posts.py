"""Door posts that are no landmarks (IV): features for doors and rooms, left out of association and update."""

import numpy as np
import pytest

from mecp_env.slam.association import OracleAssociator, make_associator
from mecp_env.slam.association.gating import MatchBuilder
from mecp_env.slam.association.paper import PostsApart
from mecp_env.slam.config import AssociationConfig, SlamConfig
from mecp_env.slam.messages import CornerKind, Decision, FeatureState, Reason
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make
from tests.slam.drives import Given

JAMB = int(CornerKind.JAMB)
APART = AssociationConfig(use_posts=False)


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


def shown_to(answer, drive):
    """Pipeline, output and match of each scan of a drive, were the associator without posts one that answers so."""
    for pipeline, output, _, _ in drive.run(SlamConfig(association={"use_posts": False})):
        nowhere = np.full(len(output.corners), -1)
        view = pipeline.map.view(output.belief, pipeline.rooms.graph(), nowhere, output.step)
        plain, posts = (np.flatnonzero((output.corners.kind == JAMB) == post) for post in (False, True))
        rings = (np.append(plain[:3], posts[:1]), plain[1:4])
        apart = PostsApart(Given(answer), APART)
        yield pipeline, output, apart.associate(output.corners, tuple(map(make.polygon, rings)), view, pipeline.filter)


def test_corners_and_polygons_of_the_scan_keep_their_numbers(drive):
    """The other associator sees neither posts nor polygons with one; its decisions come back for the right corners."""
    seen, checked = [], 0

    def first_corner(corners, polygons, view, belief):
        seen.append((corners, polygons, view))
        builder = MatchBuilder(len(corners))
        if len(corners) and len(view.features):
            builder.assign(0, Decision.LANDMARK, Reason.POLYGON, 0, 2.5)
        builder.polygon, builder.map_polygon = 0, 7
        return builder.match()

    for pipeline, output, match in shown_to(first_corner, drive):
        plain, posts = (np.flatnonzero((output.corners.kind == JAMB) == post) for post in (False, True))
        if not len(posts) or len(plain) < 4 or posts[0] > plain[1]:
            continue
        corners, polygons, view = seen[-1]
        np.testing.assert_array_equal(corners.z, output.corners.z[plain])
        assert [list(polygon.corners) for polygon in polygons] == [[1, 2, 3]]
        assert (kinds(pipeline, view.belief.ids) != JAMB).all()
        assert all((kinds(pipeline, group.ids) != JAMB).all() for group in view.groups.values())
        assert (match.polygon, match.known) == (1, 7)
        assert (match.decision[plain[0]], match.nis[plain[0]]) == (Decision.LANDMARK, 2.5)
        assert (match.decision[posts] != Decision.LANDMARK).all()
        checked += 1
    assert checked > 5


def test_a_corner_that_is_no_post_is_named_only_as_a_post(drive):
    plain_named = posts_named = 0
    for pipeline, output, match in shown_to(lambda corners, *_: MatchBuilder(len(corners)).match(), drive):
        named = np.flatnonzero(match.decision == int(Decision.PROVISIONAL))
        plain = named[output.corners.kind[named] != JAMB]
        assert (kinds(pipeline, match.ids[plain]) == JAMB).all()
        plain_named, posts_named = plain_named + len(plain), posts_named + len(named) - len(plain)
    assert plain_named > 0
    assert posts_named > 50


def test_known_correspondences_include_posts():
    config = AssociationConfig(use_posts=False, method="known")
    assert isinstance(make_associator(config), OracleAssociator)
    assert isinstance(make_associator(APART), PostsApart)


def test_the_papers_mode_leaves_posts_out():
    paper = SlamConfig.paper()
    assert not paper.association.use_posts
    assert paper.polygon.sites == "corners"
    assert paper.association.gate_probability == 0.99


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
