"""`mecp-env replay`: the page that plays a kept run."""

from __future__ import annotations

import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from mecp_env.cli.base import Command, check_writable
from mecp_env.cli.exit_codes import INTERRUPTED, echo
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import read_json

PAGE, MOST_BYTES = "replay.html", 5_000_000  # of a configuration
REMEDY = "name the folder of a run of `mecp-env demo` or `mecp-env slam`, or a page that one wrote"


@dataclass(frozen=True)
class Replay(Command):
    """Make the page that plays a run: world and belief side by side, with a time slider, why each corner was matched or
    not, and curves. RUN is the folder of a run, or its page, which gets the player of this version. A folder of `demo`
    without a page is explored again, with the same bits."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env replay runs/paper-0",
        "mecp-env replay runs/paper-0 --browser",
        "mecp-env replay runs/training/replays/episode-0003.html --out best.html",
    )

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(name="RUN", metavar="RUN")]
    out: Path | None = None  # file of the page; default: replay.html in the folder of the run, or the page itself
    browser: bool = False  # show it in the browser

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Write the page. Raises `ConfigError` and `ReplayError`."""
        from mecp_env.render.replay import play_again, write_page

        page = self.run_folder / PAGE if self.run_folder.is_dir() else self.run_folder
        out = check_writable(self.out or page)
        if page.exists():
            count = play_again(page, out)
        elif self.run_folder.is_dir():
            played = explored_again(self.run_folder)
            if not played:
                return INTERRUPTED
            write_page(played, out)
            count = len(played["frames"])
        else:
            raise ConfigError(f"{self.run_folder}: there is no such file or folder; {REMEDY}")
        echo(f"{count} frames: {out}")
        if self.browser:
            webbrowser.open(out.absolute().as_uri())
        return 0


def explored_again(folder: Path) -> dict[str, Any]:
    """The run that `demo` kept in a folder, by its configuration; nothing after Ctrl-C. Raises `ConfigError`."""
    from contextlib import suppress

    from mecp_env.cli.explore import Run
    from mecp_env.cli.progress import ExplorationBar
    from mecp_env.cli.stopwatch import timed_stages
    from mecp_env.config import EnvConfig
    from mecp_env.env import MecpEnv

    recipe = recipe_of(folder)
    run = Run(MecpEnv(EnvConfig.build(recipe["config"])), recipe["seed"])
    with timed_stages() as watch, ExplorationBar(run, watch) as bar, suppress(KeyboardInterrupt):
        run.explore(bar.show)
    return run.replay() if run.ended != "interrupted" else {}


def recipe_of(folder: Path) -> dict[str, Any]:
    """`config.json` of a run of `demo`. Raises `ConfigError` where there is none, or another kind of file."""
    path = folder / "config.json"
    try:
        recipe = read_json(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: neither {PAGE} nor a config.json that can be read ({error}); {REMEDY}") from None
    known = isinstance(recipe, dict) and recipe.get("policy") == "breadth_first"
    if not (known and isinstance(recipe.get("seed"), int) and isinstance(recipe.get("config"), dict)):
        raise ConfigError(f"{path}: no run of `mecp-env demo`; {REMEDY}")
    return dict(recipe)
