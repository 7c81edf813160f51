"""The estimators of an episode: `slam`, and the upper bounds `known` and `truth`, which are given ground truth."""

from __future__ import annotations

from typing import cast

from mecp_env.episode.true_world import TrueWorld
from mecp_env.evaluation.metrics import EpisodeMetrics
from mecp_env.slam.association import OracleAssociator
from mecp_env.slam.config import SlamConfig
from mecp_env.slam.filters import make_filter
from mecp_env.slam.filters.oracle import OraclePoseFilter
from mecp_env.slam.pipeline import SlamPipeline
from mecp_env.slam.protocols import Filter


class NoOracle:
    """The estimator has the measurements only."""

    def make_pipeline(self, config: SlamConfig) -> SlamPipeline:
        """A new estimator."""
        return SlamPipeline(config)

    def inform(self, pipeline: SlamPipeline, world: TrueWorld, metrics: EpisodeMetrics) -> None:
        """Give the estimator what it may know of the next scan, taken from where the robot is now."""


class CorrespondenceOracle(NoOracle):
    """The associator, which the configuration names, knows the true corner of each corner."""

    def inform(self, pipeline: SlamPipeline, world: TrueWorld, metrics: EpisodeMetrics) -> None:
        associator = cast("OracleAssociator", pipeline.associator)
        associator.correspondences = world.truth.correspondences(world.T_world_robot, world.obstacles())


class PoseOracle(NoOracle):
    """The filter knows the true pose."""

    def make_pipeline(self, config: SlamConfig) -> SlamPipeline:
        return SlamPipeline(config, filter=cast("Filter", OraclePoseFilter(make_filter(config.filter))))

    def inform(self, pipeline: SlamPipeline, world: TrueWorld, metrics: EpisodeMetrics) -> None:
        cast("OraclePoseFilter", pipeline.filter).T_map_robot = metrics.in_map(world.T_world_robot)


ORACLES = {"slam": NoOracle(), "known": CorrespondenceOracle(), "truth": PoseOracle()}
