"""`mecp-env completion`: the completion of commands and options in a shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Union

import tyro

from mecp_env.cli.base import Command

Shell = Literal["bash", "zsh", "fish"]
GROUP = "buildings as files, pictures and figures"


@dataclass(frozen=True)
class Completion(Command):
    """Print a script that completes commands and options of mecp-env in bash, zsh or fish."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env completion bash > ~/.local/share/bash-completion/completions/mecp-env",
        "mecp-env completion zsh > ~/.zfunc/_mecp-env",
        "mecp-env completion fish > ~/.config/fish/completions/mecp-env.fish",
    )
    shell: tyro.conf.Positional[Shell]

    def run(self, line: Sequence[str]) -> int:
        """Let the parser of all commands write the script; it is not run."""
        try:
            tyro.cli(all_commands(), prog="mecp-env", args=["--tyro-write-completion", self.shell, "-"])
        except SystemExit as end:
            return int(end.code or 0)
        raise AssertionError("the parser ends the process after the script")


def all_commands() -> Any:
    """One type of all commands, `worlds list` and its like as commands of a command."""
    from mecp_env.cli.main import COMMANDS, load

    groups = dict[str, list[Any]]()
    for words, (_, _, about) in COMMANDS.items():
        group, _, name = words.rpartition(" ")
        groups.setdefault(group, []).append(_named(load(words), name, about))
    kinds = groups.pop("") + [_named(Union[tuple(inner)], name, GROUP) for name, inner in groups.items()]  # noqa: UP007
    return Union[tuple(kinds)]  # noqa: UP007


def _named(kind: Any, name: str, about: str) -> Any:
    return Annotated[kind, tyro.conf.subcommand(name=name, description=about)]
