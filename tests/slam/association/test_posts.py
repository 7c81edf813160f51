"""Door posts that are no landmarks (IV): features for doors and rooms, left out of association and update."""

import numpy as np
import pytest

from mecp_env.slam.config import SlamConfig
from mecp_env.slam.messages import CornerKind, Decision, FeatureState
from mecp_env.slam.pipeline import SlamPipeline
from tests.slam import make

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
