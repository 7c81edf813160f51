"""The command `mecp-env`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from mecp_env.config import EnvConfig
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
    out: Path = Path("docs/images/one-scan")  # folder for the pictures


def main(arguments: list[str] | None = None) -> int:
    """Run a command; exit code 0, 2 for wrong input (also from the parser itself), 130 after Ctrl-C."""
    commands: dict[str, Callable[..., Any]] = {"demo": Demo, "one-scan": OneScan}
    chosen = tyro.extras.subcommand_cli_from_dict(
        commands,
        prog="mecp-env",
        description="Active SLAM indoors: EKF-SLAM with Maximum Empty Convex Polygons.",
        args=sys.argv[1:] if arguments is None else arguments,
        config=(tyro.conf.AvoidSubcommands,),
    )
    try:
        return run_demo(chosen) if isinstance(chosen, Demo) else draw_one_scan(chosen)
    except MecpError as error:
        print(f"mecp-env: {error}", file=sys.stderr)
        return WRONG_INPUT
    except OSError as error:
        print(f"mecp-env: {error.filename or 'output'}: {error.strerror}", file=sys.stderr)
        return WRONG_INPUT


def configuration(layout: str, fields: EnvConfig) -> EnvConfig:
    """The configuration in which only those fields are set that the command line changed."""
    changed = changes(fields.model_dump(mode="json"), Fields().model_dump(mode="json"))
    return EnvConfig.build(changed | {"layout": layout})


def changes(given: Mapping[str, Any], default: Mapping[str, Any]) -> dict[str, Any]:
    """What of `given` differs from `default`, section by section."""
    found: dict[str, Any] = {}
    for name, value in given.items():
        if isinstance(value, dict) and isinstance(default[name], dict):
            inner = changes(value, default[name])
            found |= {name: inner} if inner else {}
        elif value != default[name]:
            found[name] = value
    return found


def run_demo(given: Demo) -> int:
    """Explore with a progress bar; after Ctrl-C, what there is is kept all the same."""
    from mecp_env.demo import Run  # pictures and physics are loaded only where they are used
    from mecp_env.progress import Progress, say_result
    from mecp_env.stopwatch import timed_stages

    folder = given.out or Path("runs") / f"{Path(given.layout).stem}-{given.seed}"
    run = Run.begin(configuration(given.layout, given.config), given.seed, None if given.render == "none" else "human")
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
