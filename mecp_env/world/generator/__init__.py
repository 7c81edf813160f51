"""Generated buildings: a specification and a seed give a layout with known rooms and doors.

`generate(spec, seed)` divides a rectangle among the rooms (`partition`), finds the walls between them (`walls`), opens
doors along a spanning tree and one more per loop (`doorplan`), and places furniture (`furniture`).
"""

from mecp_env.world.generator.build import generate
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS, GeneratorSpec, split_seed, unknown_split

__all__ = ["DIFFICULTIES", "SPLITS", "GeneratorSpec", "generate", "split_seed", "unknown_split"]
