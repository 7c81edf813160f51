"""Buildings without end: a specification and a seed give a layout whose rooms and doors are known.

`generate(spec, seed)`: divide a rectangle among the rooms (`partition`), find the walls between them (`walls`), open
doors along a spanning tree and as many more as there shall be loops (`doorplan`), put up furniture (`furniture`).
"""

from mecp_env.world.generator.build import generate
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS, GeneratorSpec, split_seed, unknown_split

__all__ = ["DIFFICULTIES", "SPLITS", "GeneratorSpec", "generate", "split_seed", "unknown_split"]
