"""Combined constraint data association (CCDA): the largest set of pairs that agree on all distances.

T. Bailey, "Mobile robot localisation and mapping in extensive outdoor environments", PhD thesis, University of Sydney,
2002, chapter 3. The graph and its maximum clique are those of cliques.py, without a limit of the heading. A final joint
test (Gauss-Newton where the prediction is wide) must hold for all pairs of the clique together; while it does not, the
pair that disturbs most is left out.

Nodes are limited by the gate of the pose, by rooms and by descriptors (`use_rooms`, `use_descriptor`); polygons are
never used. Distances do not show a reflection: the joint test does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from mecp_env.core.array_types import Ints
from mecp_env.slam.association.cliques import ANY_HEADING, PairGraph, jointly_compatible
from mecp_env.slam.association.gating import chi2_gate, pairing_table
from mecp_env.slam.association.match_builder import MatchBuilder
from mecp_env.slam.config import AssociationConfig
from mecp_env.slam.messages import Corners, Decision, MapView, Match, Polygon, Reason
from mecp_env.slam.protocols import Associator, Filter


@dataclass(slots=True, eq=False)
class CcdaAssociator(Associator):
    """The clique found within `search_budget` nodes; then the best one so far counts."""

    config: AssociationConfig
    gate: float = field(init=False)  # NIS of a single pair

    def __post_init__(self) -> None:
        self.gate = chi2_gate(2, self.config.gate_probability)

    def associate(self, corners: Corners, polygons: tuple[Polygon, ...], view: MapView, belief: Filter) -> Match:
        """One decision per corner."""
        builder = MatchBuilder(len(corners))
        if not (len(view.belief.ids) and len(corners)):
            return builder.match()
        table = pairing_table(corners, view, belief, self.config, self.gate)
        graph = PairGraph.of(corners, table.costs, view, belief, self.config, ANY_HEADING)
        clique = self._selected(graph)
        if len(clique):
            rows, ids = graph.rows[clique], graph.ids[clique]
            iterate = not self.config.is_sharp(view.belief)
            fits = jointly_compatible(corners, rows, ids, belief, self.config, iterate)
            builder.assign(rows[fits], Decision.LANDMARK, Reason.JOINT, ids[fits], graph.costs[clique][fits])
        return builder.classify_unmatched(table.nis, self.config.ignore_gate).match()

    def _selected(self, graph: PairGraph) -> Ints:
        """Indices (k,) of the pairs that the joint test gets."""
        return graph.largest()
