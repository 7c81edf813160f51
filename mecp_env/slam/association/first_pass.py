"""Where the prediction is wide: the pose at which most corners are landmarks, unless another is about as good."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from mecp_env.core.carriers import Array, Ints
from mecp_env.slam.association.cliques import Headings, PairGraph, jointly_compatible
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import NO_ID, Corners, MapView
from mecp_env.slam.protocols import Filter

FEWER = 2  # pairs that the clique of a rival may have less than the best pose has


@dataclass(slots=True)
class FirstPass:
    """Poses are proposed by sets of pairs; each is judged by all pairs that are found at it.

    The score of a pose is `rival_gap` per pair, less the joint NIS of the pairs at the prediction. A pose wins by
    `rival_gap`, or none does: of two equal rooms, nothing tells which it is.
    """

    config: AssociationConfig
    corners: Corners
    view: MapView
    belief: Filter
    pair: Callable[[Filter], MatchBuilder]  # all corners, at the pose of a filter
    tried: list[MatchBuilder] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)

    def propose(self, rows: Ints, ids: Ints) -> None:
        """Judge the pose of the pairs (k,), unless a pose that was judged has most of them."""
        if self._alike(rows, ids) is not None:
            return
        corrected = self.belief.copy()
        corrected.update(*self.corners.measurements(rows), ids, iterate=True)
        builder = self.pair(corrected)
        rows = np.flatnonzero(builder.rows["id"] != NO_ID)
        if not len(rows):
            return
        ids = builder.rows["id"][rows]
        nis = self.belief.joint_nis(*self.corners.measurements(rows), ids, iterate=True)
        self._enter(builder, self.config.rival_gap * len(rows) - nis, self._alike(rows, ids))

    def _alike(self, rows: Ints, ids: Ints) -> int | None:
        """The pose judged before that has most of the pairs (k,)."""
        shared = [np.count_nonzero(builder.rows["id"][rows] == ids) for builder in self.tried]
        return next((k for k, count in enumerate(shared) if 2 * count > len(rows)), None)

    def _enter(self, builder: MatchBuilder, score: float, alike: int | None) -> None:
        """A pose that was judged; of two that are alike, the better one."""
        if alike is None:
            self.tried.append(builder)
            self.scores.append(score)
        elif score > self.scores[alike]:
            self.tried[alike], self.scores[alike] = builder, score

    def propose_cliques(self, costs: Array) -> None:
        """Propose the largest sets of pairs that agree, each of pairs that no pose before has; costs (n,N)."""
        corners, belief, config = self.corners, self.belief, self.config
        pose, tolerance = self.view.belief, math.radians(config.descriptor_deg)
        heading = Headings(
            pose.T_map_robot.item(2), pose.pose_cov.item(8), tolerance if config.use_descriptor else math.inf
        )
        graph = PairGraph.of(corners, costs, self.view, belief, config, heading)
        while self.is_clear:
            for builder in self.tried:
                graph.leave_out(builder.rows["id"])
            clique = graph.largest(max(1, self.most_pairs - FEWER))
            rows, ids = graph.rows[clique], graph.ids[clique]
            fits = jointly_compatible(corners, rows, ids, belief, config, iterate=True)
            if not len(fits):
                return
            self.propose(rows[fits], ids[fits])
            graph.alive[clique] = False

    @property
    def most_pairs(self) -> int:
        """Of a pose that was judged."""
        return max((builder.paired for builder in self.tried), default=0)

    @property
    def is_clear(self) -> bool:
        """False as soon as two poses are about equally good."""
        *others, best = sorted([-math.inf, *self.scores])
        return not others or others[-1] <= best - self.config.rival_gap

    def best(self) -> MatchBuilder | None:
        """The decisions at the pose that wins."""
        return self.tried[int(np.argmax(self.scores))] if self.tried and self.is_clear else None
