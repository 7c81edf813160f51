"""`mecp-env worlds draw`: floor plans as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import Field

from mecp_env.cli.base import Command, check_writable
from mecp_env.cli.buildings import Buildings, Reading, ReadingOptions, expand_all, load, spare_sources, stem
from mecp_env.cli.exit_codes import echo
from mecp_env.world.schema import Layout


@dataclass(frozen=True)
class Draw(Command):
    """Draw floor plans: one building as a picture, several as a sheet."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds draw office",
        "mecp-env worlds draw hard:0-8 --out runs/hard.png",
        "mecp-env worlds draw my-house.json paper --out runs/two.svg",
        "mecp-env worlds draw scan.png --resolution-m 0.05",
    )

    worlds: Buildings  # shipped names, hard:7, hard:0-9 (difficulty and seeds), files, folders
    out: Path | None = None  # the picture, .png or .svg; default: runs/NAME.png
    dpi: Annotated[int, Field(ge=30, le=600)] = 200  # pixels per inch of a PNG, 30 to 600
    reading: ReadingOptions = field(default_factory=Reading)

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Draw, and say where the picture is."""
        from mecp_env.render.plan_figures import check_count, check_format  # matplotlib is loaded only here

        if self.out:
            check_writable(check_format(self.out))
        words = expand_all(self.worlds, self.reading)
        check_count(len(words))
        path = self.out or Path("runs") / f"{stem(words[0]) if len(words) == 1 else 'worlds'}.png"
        spare_sources([path], words)
        buildings = [(title(word), load(word, self.reading)) for word in words]
        echo(str(draw(buildings, path, self.dpi)))
        return 0


def title(word: str) -> str:
    """What a building is called in a picture: as it was asked for, of a file its name."""
    return Path(word).stem if Path(word).exists() else word


def draw(buildings: Sequence[tuple[str, Layout]], path: Path, dpi: int = 200) -> Path:
    """Draw buildings, each with its title, on a sheet and save it; `path` itself, whose folder is made."""
    from mecp_env.floorplans.plan_view import floor_plan
    from mecp_env.render.plan_figures import save_plans

    plans = [floor_plan(layout, title) for title, layout in buildings]
    check_writable(path).parent.mkdir(parents=True, exist_ok=True)
    save_plans(plans, path, dpi)
    return path
