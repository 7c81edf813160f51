"""Custom parts of the estimator: the names that a configuration may hold, and the maker of each."""

from __future__ import annotations

from collections.abc import Callable, MutableMapping
from typing import TypeVar

from mecp_env.core.errors import ConfigError
from mecp_env.core.settings import guess, shown
from mecp_env.core.snapshot import admit

Make = TypeVar("Make", bound=Callable[..., object])


class Names:
    """The names that a field may hold: built-in and registered ones."""

    def __init__(self, *ours: str) -> None:
        self.ours, self.others = ours, list[str]()

    def check(self, name: str) -> str:
        """`name` itself. Raises `ValueError` for an unknown one."""
        known = [*self.ours, *self.others]
        if name not in known:
            listed = f"{', '.join(map(repr, known[:-1]))} or {known[-1]!r}"
            raise ValueError(f"Input should be {listed}{guess(name, known)}")
        return name

    def add(self, name: object) -> None:
        """Let the field hold `name`, too. Raises `ConfigError` for one of ours, and for what is no name."""
        if not isinstance(name, str) or not name.isidentifier():
            raise ConfigError(f"name: {shown(name)}, letters, digits and _ expected")
        if name in self.ours:
            raise ConfigError(f"name: {name!r} is one of ours ({', '.join(self.ours)}); choose another")
        if name not in self.others:
            self.others.append(name)


def register(names: Names, makers: MutableMapping[str, Make], name: str, make: Make) -> None:
    """Make `name` known, and states ready to hold what `make` makes, where that is a class. Raises `ConfigError`."""
    if not callable(make):
        raise ConfigError(f"make: {shown(make)}, a class or a function expected")
    names.add(name)
    makers[name] = make
    if isinstance(make, type):
        admit(make)
