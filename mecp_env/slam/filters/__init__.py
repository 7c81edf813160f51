"""Filters: pose and landmarks as one Gaussian. `make_filter(config)` gives the one the configuration names."""

from __future__ import annotations

from collections.abc import Callable

from mecp_env.slam.config import KINDS, FilterConfig
from mecp_env.slam.custom import maker_of, register
from mecp_env.slam.filters.core import Ekf, RightInvariantEkf
from mecp_env.slam.filters.submap import SubmapEkf
from mecp_env.slam.filters.window import Window, WindowFilter
from mecp_env.slam.protocols import Filter, FilterError

__all__ = [
    "FILTERS",
    "Ekf",
    "Filter",
    "FilterError",
    "RightInvariantEkf",
    "SubmapEkf",
    "Window",
    "WindowFilter",
    "make_filter",
    "register_filter",
]

FILTERS: dict[str, Callable[[FilterConfig], Filter]] = {
    "riekf": RightInvariantEkf,
    "riekf_submaps": SubmapEkf,
    "ekf": Ekf,
}


def register_filter(name: str, make: Callable[[FilterConfig], Filter]) -> None:
    """Let `filter.kind` name a custom filter, in every configuration that this process reads.

    `make(config.filter)` is called for each pipeline. A built-in name raises `ConfigError`; any other may be
    registered again. Other processes know it if they are forked from this one or import what registers it. States of
    an environment can hold it if `make` is its class.
    """
    register(KINDS, FILTERS, name, make)


def make_filter(config: FilterConfig) -> Filter:
    """A new filter of the kind config.kind: pose at the origin with the prior's sigmas, no landmarks."""
    return maker_of(FILTERS, config.kind)(config)
