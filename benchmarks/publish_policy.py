"""Runs of one algorithm, several seeds: draw their learning curve, and ship the best policy.

`python -m benchmarks.publish_policy runs/maskable_ppo-0 runs/maskable_ppo-1 runs/maskable_ppo-2`
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from mecp_env.cli.base import run_command
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import read_config
from mecp_env.policies.registry import WEIGHTS
from mecp_env.render.palette import MARKERS

SHIPPED = ("config.json", "run.json", "evaluation.csv", "progress.csv", "policy.json")  # the last names the weights
SCORES = {"auc": "area under coverage over metres", "correct_over_steps": "correct coverage over steps"}
MOST_BYTES = 1_900_000  # of weights in the repository


@dataclass(frozen=True)
class PublishOptions:
    """Draw the learning curve of some runs, and ship the policy of the best one."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]  # folders of runs of one algorithm
    weights: Path = WEIGHTS  # folder of the shipped policies
    picture: Path | None = None  # of the curve; default: beside the weights
    ship: bool = True  # no: only the picture


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """The results of a run on the validation split."""

    folder: Path
    algorithm: str
    decisions: Array  # (n,)
    score: str  # the metric by which the best policy is chosen
    area: Array  # (n,) its values
    error: Array  # (n,) standard errors of the area under coverage over metres
    hours: float


def main(args: PublishOptions) -> int:
    """Exit code 0, 2 for wrong input, or 130 after Ctrl-C."""
    return run_command(lambda: publish(args))


def publish(args: PublishOptions) -> int:
    """Draw, and ship. Exit code 0; raises `ConfigError`."""
    if not args.runs:
        raise ConfigError("runs: none given, expected folders of runs of one algorithm")
    runs = [read_run(folder) for folder in args.runs]
    if len({(run.algorithm, run.score) for run in runs}) != 1:
        names = ", ".join(sorted({run.algorithm for run in runs}))
        raise ConfigError(f"runs: of {names}, expected one algorithm, all in tasks or none")
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
    return 0


def read_run(folder: Path) -> RunResult:
    """The figures of a run. Raises `ConfigError` for a folder without any."""
    try:
        fields = read_config(folder / "config.json")
        algorithm, score = fields["algorithm"], "correct_over_steps" if fields.get("task") else "auc"
        with (folder / "evaluation.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        decisions, area, errors, seconds = (column(rows, name) for name in ("decisions", score, "auc_error", "seconds"))
    except OSError as error:
        raise ConfigError(f"runs: {folder} is not a run folder: {error.filename}: {error.strerror}") from None
    except KeyError as error:
        raise ConfigError(f"runs: {folder} is not a run folder: {error} is missing") from None
    except ValueError as error:
        raise ConfigError(f"runs: {folder} is not a run folder: {error}") from None
    if not rows:
        raise ConfigError(f"runs: {folder} has no evaluation yet")
    return RunResult(folder, str(algorithm), decisions, score, area, errors, seconds[-1] / 3600.0)


def column(rows: list[dict[str, Any]], name: str) -> Array:
    """(n,) a column of a table. Raises `KeyError`, or `ValueError` for a value that is not a number."""
    values = np.array([float(row[name] or "") for row in rows])
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: not finite")
    return values


def ship(run: RunResult, target: Path) -> None:
    """Copy the policy of a run and where it comes from; what was shipped before goes when all of it is there.

    Raises `ConfigError` for a policy that is too large for the repository or cannot be loaded, with nothing changed.
    """
    from mecp_env.core.files import write_atomic
    from mecp_env.learning.learned import load  # with PyTorch, which the curve alone does not need

    if target.resolve() == run.folder.resolve():
        raise ConfigError(f"runs: {run.folder} is where the policy would be put")
    load(run.folder)
    weights = str(read_config(run.folder / SHIPPED[-1])["file"])
    whole = {name: (run.folder / name).read_bytes() for name in (weights, *SHIPPED)}
    if len(whole[weights]) > MOST_BYTES:
        raise ConfigError(f"{weights}: {len(whole[weights])} bytes, at most {MOST_BYTES}; a smaller network.width?")
    for name, data in whole.items():
        write_atomic(target / name, data)
    for old in target.glob("policy-*.safetensors"):
        if old.name != weights:
            old.unlink()


def draw(runs: list[RunResult], picture: Path) -> None:
    """The metric over the decisions: one line per run, with a standard error where that is known."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for run, marker in zip(runs, cycle(MARKERS)):
        (line,) = axes.plot(run.decisions, run.area, marker=marker, markersize=4, label=run.folder.name)
        error = run.error if run.score == "auc" else 0.0 * run.error
        axes.fill_between(run.decisions, run.area - error, run.area + error, alpha=0.15, color=line.get_color())
    axes.axhline(runs[0].area[0], color="0.5", linestyle="--", linewidth=1, label="untrained (its prior)")
    axes.set_xlabel("decisions")
    axes.set_ylabel(f"{SCORES[runs[0].score]}, validation")
    axes.set_title(f"{runs[0].algorithm}: band is one standard error over the buildings", fontsize=10)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    figure.savefig(picture, dpi=220)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(PublishOptions)))
