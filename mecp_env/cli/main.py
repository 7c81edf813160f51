"""The command `mecp-env`: selects the command of a line, and runs it."""

from __future__ import annotations

import importlib
import re
import sys
import textwrap
from typing import Any

from pydantic import TypeAdapter, ValidationError

import mecp_env
from mecp_env.cli.base import WRONG_INPUT, Command, Line, at_end, print_error, replace_unprintable, run_command
from mecp_env.core.errors import ConfigError
from mecp_env.core.provenance import import_modules
from mecp_env.core.settings import Settings, describe, guess

ABOUT = "Active SLAM indoors: EKF-SLAM with Maximum Empty Convex Polygons."
COMMANDS = {  # words -> module below mecp_env.cli, class, what the overview says
    "demo": ("demo", "Demo", "explore a building by the robot's own map; keep pictures and figures"),
    "replay": ("demo", "Replay", "the page that plays a kept run, and shows why the robot believes what it does"),
    "one-scan": ("demo", "OneScan", "follow one scan through the stages, with a picture each"),
    "slam": ("slam", "Slam", "map a recorded log: CARMEN, a ROS bag or an .npz; keep pictures and figures"),
    "export": ("slam", "Export", "landmarks, rooms, graph and grid of a saved map for other programs"),
    "explore": ("explore", "Explore", "one episode of a policy: a line per drive, and the metrics"),
    "evaluate": ("evaluate", "Evaluate", "compare policies in the same buildings: tables, curves, a film"),
    "submit": ("evaluate", "Submit", "score one policy in a frozen benchmark; write its result file"),
    "leaderboard": ("evaluate", "Leaderboard", "one table of several results of a frozen benchmark"),
    "record-dataset": ("explore", "RecordDataset", "episodes of a policy as a Minari dataset"),
    "train": ("train", "Train", "train a policy, or resume a run"),
    "play": ("play", "Play", "drive by keyboard: ground truth on the left, the estimate on the right"),
    "warmup": ("warmup", "WarmUp", "compile ahead, on all cores; once per installation"),
    "doctor": ("doctor", "Doctor", "check the installation, and drive for two seconds"),
    "completion": ("doctor", "Completion", "complete commands and options in bash, zsh or fish"),
    "worlds list": ("worlds", "List", "the buildings there are, shipped and generated"),
    "worlds draw": ("worlds", "Draw", "floor plans as PNG or SVG; several on a sheet"),
    "worlds generate": ("worlds", "Generate", "new buildings from a specification and seeds"),
    "worlds validate": ("worlds", "Validate", "whether files are sound, or what is wrong and where"),
    "worlds convert": ("worlds", "Convert", "from one format to another"),
    "worlds stats": ("worlds", "Stats", "rooms, doors, loops, corners... in a table"),
}
GROUPS = {words.partition(" ")[0] for words in COMMANDS if " " in words}
WIDEST = max(map(len, COMMANDS))


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit code 0, 2 for wrong input (also from the parser itself), 130 after Ctrl-C."""
    replace_unprintable()
    words, line = split(sys.argv[1:] if arguments is None else arguments)
    return at_end(run_command(lambda: parse(words, line).run(line)))


def split(line: list[str]) -> tuple[str, Line]:
    """The command that a line starts with, and its options; ends the process after `--help`, with 2 without one."""
    for count in (2, 1):
        words = " ".join(line[:count])
        if words in COMMANDS:
            return words, Line(line[count:])
    group = line[0] if line and line[0] in GROUPS else ""
    raise SystemExit(answer(group, next(iter(line[1:] if group else line), "")))


def answer(group: str, word: str) -> int:
    """Print what a line without a command asks for; the exit code."""
    if word in ("-h", "--help"):
        print(overview(group))
    elif word == "--version":
        print(f"mecp-env {mecp_env.__version__}")
    else:
        return refuse(f"{group} {word}".strip() if word else "", group)
    return 0


def refuse(words: str, group: str) -> int:
    """Print that `words` are not a command, with a suggestion and the known commands; the exit code."""
    print(overview(group) + "\n", file=sys.stderr)
    print_error(f"unknown command {words!r}{guess(words, COMMANDS)}" if words else "a command is missing")
    return WRONG_INPUT


def overview(group: str) -> str:
    """All commands, or those of a group (`worlds`), a line each."""
    shown = [words for words in COMMANDS if words.startswith(group)]
    lines = [f"  {words:{WIDEST}}  {COMMANDS[words][2]}" for words in shown]
    command = f"mecp-env {group}".strip()
    usage = f"usage: {command} COMMAND [OPTIONS]"
    return "\n".join([usage, "", ABOUT, "", *lines, "", f"`{command} COMMAND --help` shows options and examples."])


def load(words: str) -> type[Command]:
    """The class of a command; only now is its module loaded."""
    module, name, _ = COMMANDS[words]
    kind: type[Command] = getattr(importlib.import_module(f"mecp_env.cli.{module}"), name)
    return kind


def parse(words: str, line: Line) -> Command:
    """A command with its options. Ends the process after `--help`, and with 2 for wrong options.

    Raises `ConfigError` for an option out of its bounds.
    """
    import tyro  # the overview does without

    from mecp_env.cli.options import hints

    kind = load(words)
    import_modules(line.first_words("--with"))  # they register names that options may have
    line = kind.completed(line.gathered())
    about, examples = kind.help()
    wrapped, shown = ("\n".join(f"  {line}" for line in lines) for lines in (textwrap.wrap(about, 76), examples))
    default: Any = kind.defaults(line)  # None: tyro takes those of the class
    try:
        chosen: Command = tyro.cli(
            kind,
            prog=f"mecp-env {words}",
            description=f"{wrapped}\n\nExamples:\n{shown}",  # tyro keeps indented lines
            args=list(line),
            default=default,
            config=(tyro.conf.AvoidSubcommands,),
        )
    except SystemExit as end:
        for hint in hints(kind, line) if end.code else ():
            print_error(hint)
        raise
    try:
        command = TypeAdapter(kind).validate_python(vars(chosen))
    except ValidationError as error:
        raise ConfigError(re.sub(r"(^|; )option\.(\w+)", _as_typed, describe(error, "option", Settings))) from None
    command.check(line)
    return command


def _as_typed(found: re.Match[str]) -> str:
    """The option of a field, as a user types it."""
    return f"{found[1]}--{found[2].replace('_', '-')}"


if __name__ == "__main__":
    sys.exit(main())
