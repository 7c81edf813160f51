"""Filters: pose and landmarks as one Gaussian. `make_filter(config)` gives the one the configuration names."""

from __future__ import annotations

from mecp_env.slam.config import FilterConfig
from mecp_env.slam.filters.ekf import Ekf
from mecp_env.slam.filters.riekf import RightInvariantEkf
from mecp_env.slam.protocols import Filter, FilterError

__all__ = ["Ekf", "Filter", "FilterError", "RightInvariantEkf", "make_filter"]

KINDS = {"riekf": RightInvariantEkf, "ekf": Ekf}


def make_filter(config: FilterConfig) -> Filter:
    """A new filter of the kind config.kind: pose at the origin with the prior's sigmas, no landmarks."""
    return KINDS[config.kind](config)
