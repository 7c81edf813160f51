"""The one place where a filter that diverges is noticed."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType

from mecp_env.slam.messages import Belief
from mecp_env.slam.protocols import FilterError


@dataclass(slots=True, eq=False)
class Divergence:
    """Whether the filter has diverged so far. As a context, it ends the block at a `FilterError` and notes it."""

    limit_m: float  # a pose with a larger sigma in x or y is worth nothing any more
    found: bool = False

    def watch(self, belief: Belief) -> Belief:
        """`belief` itself; the sigma of its position is compared with the limit."""
        self.found |= not max(belief.pose_cov[0, 0], belief.pose_cov[1, 1]) < self.limit_m**2
        return belief

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> bool:
        failed = isinstance(error, FilterError)
        self.found |= failed
        return failed
