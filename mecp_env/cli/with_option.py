"""The option `--with`: modules of the user that register custom parts by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import tyro

from mecp_env.cli.base import Command

OPTION = "--with"


@dataclass(frozen=True, kw_only=True)
class WithModules(Command):
    """A command that knows what modules of the user register: associators, filters, rewards, policies, ..."""

    # a module of yours that registers custom parts by name, such as my_parts for my_parts.py; may be given again
    modules: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(name="with", metavar="MODULE")] = ()

    @classmethod
    def completed(cls, line: Sequence[str]) -> list[str]:
        """The line with the preset of the reward that weights without one stand for."""
        if not any(".reward." in word for word in line):
            return list(line)
        from mecp_env.cli.fields import with_reward_preset

        return with_reward_preset(line)

    @classmethod
    def own_modules(cls, line: Sequence[str]) -> list[str]:
        after = [word for option, word in pairwise(line) if option == OPTION]
        return [*after, *(word.partition("=")[2] for word in line if word.startswith(f"{OPTION}="))]
