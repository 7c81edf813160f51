"""`mecp-env worlds generate`: buildings from a specification and seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, get_args

import tyro
from pydantic import Field

from mecp_env.cli.base import Command, Seed, check_folder, check_writable
from mecp_env.cli.buildings import counted
from mecp_env.cli.exit_codes import echo
from mecp_env.core.errors import ConfigError
from mecp_env.world.generator.spec import DIFFICULTIES, SPLITS, Difficulty, GeneratorSpec, Piece, Shape, split_seed
from mecp_env.world.schema import Layout

OPTION = "--difficulty"
RANGES = tuple(f"--{name.replace('_', '-')}" for name, value in GeneratorSpec() if isinstance(value, tuple))


@dataclass(frozen=True)
class Generate(Command):
    """Generate buildings: layout files whose rooms, doors and loops are known. Every field of the specification is an
    option; what is not given is what the difficulty has (`--difficulty hard --help` shows it)."""

    examples: ClassVar[tuple[str, ...]] = (
        "mecp-env worlds generate --difficulty hard --seed 7",
        "mecp-env worlds generate --rooms 12 --loops 3 --count 20 --out runs/twelve --sheet runs/twelve.png",
        "mecp-env worlds generate --difficulty easy --split test --count 10",
    )

    difficulty: Difficulty = "medium"  # the preset below the other options
    seed: Seed = 0  # the first seed; with a split, the first building of the split
    count: Annotated[int, Field(ge=1, le=10_000)] = 1  # so many seeds, one after the other
    split: Literal["train", "validation", "test"] | None = None  # seeds kept apart, so that results compare
    out: Path = Path("runs/worlds")  # folder for DIFFICULTY-SEED.json, or for one building a .json file
    sheet: Path | None = None  # also draw all of them here, .png or .svg
    spec: tyro.conf.OmitArgPrefixes[GeneratorSpec] = field(default_factory=GeneratorSpec)

    choices: ClassVar[Mapping[str, Sequence[str]]] = {
        OPTION: tuple(DIFFICULTIES),
        "--split": tuple(SPLITS),
        "--shapes": get_args(Shape),
        "--pieces": get_args(Piece),
    }

    @classmethod
    def completed(cls, line: Sequence[str]) -> list[str]:
        """The line with a single number for a range as the range from it to itself."""
        whole: list[str] = []
        for before, word, after in zip(["", *line], line, [*line[1:], ""], strict=False):
            single = before in RANGES and _is_number(word) and not _is_number(after)
            whole += [word, word] if single else [word]
        return whole

    @classmethod
    def defaults(cls, line: Sequence[str]) -> Self | None:
        """Those of the difficulty that the line names."""
        words = [word for option in line for word in option.split("=", 1)]
        chosen = words[words.index(OPTION) + 1] if OPTION in words[:-1] else "medium"
        return cls(spec=GeneratorSpec.preset(chosen)) if chosen in DIFFICULTIES else None

    keeps_results = True

    def run(self, line: Sequence[str]) -> int:
        """Write the files, one line on each."""
        self._check()
        drawn = []
        for path, layout in self._buildings():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(layout.to_json(), encoding="utf-8")
            echo(f"{path}: {counted(layout)}")
            drawn += [(path.stem, layout)] if self.sheet else []
        if self.sheet:
            from mecp_env.cli.worlds_draw import draw

            echo(str(draw(drawn, self.sheet)))
        return 0

    def _check(self) -> None:
        """Raise `ConfigError` for what would fail only after some of the work."""
        try:
            self._seed(self.seed + self.count - 1)
        except ConfigError as error:  # the split has not so many buildings
            raise ConfigError(f"seed: {self.seed}, with count {self.count} up to {error}") from None
        if self.out.suffix == ".json" and self.count > 1:
            raise ConfigError(f"out: {self.out} is one file for {self.count} buildings; give a folder")
        (check_writable if self.out.suffix == ".json" else check_folder)(self.out)
        if self.sheet:
            from mecp_env.render.plan_figures import check_count, check_format

            check_writable(check_format(self.sheet), "--sheet")
            check_count(self.count)

    def _seed(self, number: int) -> int:
        return split_seed(self.split, number) if self.split else number

    def _buildings(self) -> Iterator[tuple[Path, Layout]]:
        """Path and layout of every building."""
        from mecp_env.world.generator import generate

        for seed in map(self._seed, range(self.seed, self.seed + self.count)):
            path = self.out if self.out.suffix == ".json" else self.out / f"{self.difficulty}-{seed}.json"
            yield path, generate(self.spec, seed)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
