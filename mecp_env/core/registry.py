"""Custom parts of the estimator: the maker of each name that a configuration may hold."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from typing import TypeVar

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import Names, shown
from mecp_env.core.snapshot import admit

Make = TypeVar("Make", bound=Callable[..., object])


def register(names: Names, makers: MutableMapping[str, Make], name: str, make: Make) -> None:
    """Make `name` known, and states ready to hold what `make` makes, where that is a class. Raises `ConfigError`."""
    if not callable(make):
        raise ConfigError(f"make: {shown(make)}, a class or a function expected")
    names.add(name)
    makers[name] = make
    if isinstance(make, type):
        admit(make)
