"""Runs of one algorithm, several seeds: draw their learning curve, and put the best policy into `agents/weights`.

`python -m agents.publish runs/maskable_ppo-0 runs/maskable_ppo-1 runs/maskable_ppo-2`
"""

from __future__ import annotations

import csv
import json
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from numpy.typing import NDArray

from mecp_env.errors import ConfigError, MecpError

HERE = Path(__file__).parent
SHIPPED = ("config.json", "run.json", "evaluation.csv", "policy.json")
MOST_BYTES = 1_900_000  # of weights in the repository
WRONG_INPUT = 2
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Args:
    """Draw the learning curve of some runs, and ship the policy of the best one."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]  # folders of runs of one algorithm
    weights: Path = HERE / "weights"  # where shipped policies lie
    picture: Path | None = None  # of the curve; default: beside the weights
    ship: bool = True  # no: only the picture


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a run came to on the validation split."""

    folder: Path
    algorithm: str
    decisions: Array  # (n,)
    area: Array  # (n,) under the coverage curve
    error: Array  # (n,) its standard error
    hours: float


def main(args: Args) -> int:
    """Exit code 0, or 2 for wrong input."""
    try:
        publish(args)
    except MecpError as error:
        print(f"publish: {error}", file=sys.stderr)
        return WRONG_INPUT
    return 0


def publish(args: Args) -> None:
    """Draw, and ship. Raises `ConfigError`."""
    runs = [read_run(folder) for folder in args.runs]
    if len({run.algorithm for run in runs}) != 1:
        raise ConfigError(f"runs: of {', '.join(sorted({run.algorithm for run in runs}))}, expected one algorithm")
    best = max(runs, key=lambda run: run.area.max())
    target = args.weights / best.algorithm
    if args.ship:
        ship(best, target)
        print(
            f"{target}: the policy of {best.folder}, {best.area.max():.4f} on the validation split, {best.hours:.1f} h"
        )
    picture = args.picture or target / "curve.png"
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw(runs, picture)
    print(f"{picture}: {len(runs)} runs")


def read_run(folder: Path) -> Run:
    """The figures of a run. Raises `ConfigError` for a folder without any."""
    try:
        algorithm = json.loads((folder / "config.json").read_text())["algorithm"]
        with (folder / "evaluation.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f"runs: {folder} is no folder of a run: {error}") from None
    if not rows:
        raise ConfigError(f"runs: {folder} has no evaluation yet")
    decisions, area, error = (column(rows, name) for name in ("decisions", "auc", "auc_error"))
    return Run(folder, str(algorithm), decisions, area, error, float(rows[-1]["seconds"]) / 3600.0)


def column(rows: list[dict[str, Any]], name: str) -> Array:
    """(n,) a column of a table."""
    return np.array([float(row[name]) for row in rows])


def ship(run: Run, target: Path) -> None:
    """Copy the policy of a run and where it comes from. Raises `ConfigError` for one too large for the repository."""
    weights = run.folder / json.loads((run.folder / "policy.json").read_text())["file"]
    if weights.stat().st_size > MOST_BYTES:
        raise ConfigError(f"{weights}: {weights.stat().st_size} bytes, at most {MOST_BYTES}; a smaller network.width?")
    target.mkdir(parents=True, exist_ok=True)
    for old in target.glob("policy-*.safetensors"):
        old.unlink()
    for path in (*(run.folder / name for name in SHIPPED), weights):
        shutil.copyfile(path, target / path.name)


def draw(runs: list[Run], picture: Path) -> None:
    """The area under the curve over the decisions: a line a run with its standard error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for run in runs:
        (line,) = axes.plot(run.decisions, run.area, marker="o", markersize=3, label=run.folder.name)
        axes.fill_between(run.decisions, run.area - run.error, run.area + run.error, alpha=0.15, color=line.get_color())
    axes.axhline(runs[0].area[0], color="0.5", linestyle="--", linewidth=1, label="untrained (its prior)")
    axes.set_xlabel("decisions")
    axes.set_ylabel("area under coverage over metres, validation")
    axes.set_title(f"{runs[0].algorithm}: band is one standard error over the buildings", fontsize=10)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Args)))
