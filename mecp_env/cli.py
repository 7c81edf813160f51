"""The command `mecp-env`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from mecp_env.config import EnvConfig, merge
from mecp_env.errors import MecpError

INTERRUPTED, WRONG_INPUT = 130, 2


class Fields(EnvConfig):
    """Any field of the configuration."""

    layout: Annotated[str, tyro.conf.Suppress] = "paper"
    actions: Annotated[Literal["velocity", "discrete", "goal"], tyro.conf.Suppress] = "velocity"


@dataclass(frozen=True)
class Demo:
    """Explore a building by the robot's own map, breadth first; keep pictures, figures and paths."""

    layout: str = "paper"  # paper, two_rooms, office, twins, furnished, or the path of a layout file
    seed: int = 0  # the same seed gives the same run
    render: Literal["none", "human"] = "none"  # human: watch it in a window
    out: Path | None = None  # folder for what is kept; default: runs/LAYOUT-SEED
    config: Fields = field(default_factory=Fields)  # any field of the configuration


@dataclass(frozen=True)
class OneScan:
    """Follow one scan through the stages: one picture each, as in docs/one-scan.md."""

    layout: str = "paper"  # as for demo
    seed: int = 0
    period: int = 40  # the first scan from here on in which a polygon of the map is recognised
    out: Path = Path("runs/one-scan")  # folder for the pictures


COMMANDS: dict[str, Callable[..., Any]] = {"demo": Demo, "one-scan": OneScan}
FIELD = "--config."


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit code 0, 2 for wrong input (also from the parser itself), 130 after Ctrl-C."""
    line = sys.argv[1:] if arguments is None else arguments
    chosen = parse(line)
    try:
        return run_demo(chosen, line) if isinstance(chosen, Demo) else draw_one_scan(chosen)
    except MecpError as error:
        print(f"mecp-env: {error}", file=sys.stderr)
        return WRONG_INPUT
    except OSError as error:
        print(f"mecp-env: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        return WRONG_INPUT


def parse(line: list[str]) -> Demo | OneScan:
    """The command of a line with its options; ends the process after `--help`, and with 2 for a wrong line."""
    options = (tyro.conf.AvoidSubcommands,)
    chosen: Any
    if line and line[0] in COMMANDS:  # by itself: of a subcommand, tyro's errors would not name the option
        chosen = tyro.cli(COMMANDS[line[0]], prog=f"mecp-env {line[0]}", args=line[1:], config=options)
    else:
        about = "Active SLAM indoors: EKF-SLAM with Maximum Empty Convex Polygons."
        chosen = tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="mecp-env", description=about, args=line, config=options
        )
    assert isinstance(chosen, Demo | OneScan)
    return chosen


def configuration(layout: str, fields: EnvConfig, line: Sequence[str]) -> EnvConfig:
    """The configuration in which only those fields are set that the command line names, to a default or not."""
    given, chosen = fields.model_dump(mode="json"), {"layout": layout}
    for option in line:
        if option.startswith(FIELD):
            chosen = merge(chosen, named(given, option.removeprefix(FIELD).partition("=")[0]))
    return EnvConfig.build(chosen | {"layout": layout})


def named(fields: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Of all fields the one at `path` (`laser.max-range-m`; a switch also as `slam.polygon.no-guard`)."""
    first, _, rest = path.partition(".")
    name = first.replace("-", "_")
    name = name if name in fields else name.removeprefix("no_")
    return {name: named(fields[name], rest) if rest else fields[name]}


def run_demo(given: Demo, line: Sequence[str]) -> int:
    """Explore with a progress bar; after Ctrl-C, what there is is kept all the same."""
    from mecp_env.demo import Run  # pictures and physics are loaded only where they are used
    from mecp_env.progress import Progress, say_result
    from mecp_env.stopwatch import timed_stages

    folder = given.out or Path("runs") / f"{Path(given.layout).stem}-{given.seed}"
    config = configuration(given.layout, given.config, line)
    run = Run.begin(config, given.seed, None if given.render == "none" else "human")
    folder.mkdir(parents=True, exist_ok=True)
    with timed_stages() as watch, Progress(run, watch) as progress, suppress(KeyboardInterrupt):
        run.explore(progress.show)
    if not run.estimated:
        return INTERRUPTED
    say_result(run.keep(folder, watch), folder)
    run.env.close()
    return INTERRUPTED if run.ended == "interrupted" else 0


def draw_one_scan(given: OneScan) -> int:
    """Write the pictures of one scan's stages."""
    from mecp_env.one_scan import draw

    for path in draw(EnvConfig(layout=given.layout), given.seed, given.period, given.out):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
