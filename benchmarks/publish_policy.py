"""Runs of one algorithm, several seeds: draw their learning curve, and ship the best policy.

`python -m benchmarks.publish_policy runs/maskable_ppo-0 runs/maskable_ppo-1 runs/maskable_ppo-2`
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np

from mecp_env.cli.exit_codes import run_command
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.learning.config import read_config
from mecp_env.policies.registry import WEIGHTS
from mecp_env.render.palette import MARKERS

SHIPPED = ("config.json", "run.json", "evaluation.csv", "progress.csv", "policy.json")  # the last names the weights
SCORES = {"auc": "area under coverage over metres", "correct_over_steps": "correct coverage over steps"}
COLUMNS = ("decisions", "auc_error", "seconds")  # beside the score
MOST_BYTES = 1_900_000  # of weights in the repository


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """The results of a run on the validation split."""

    folder: Path
    algorithm: str
    score: str  # the metric by which the best policy is chosen
    area: Array  # (n,) its values
    decisions: Array  # (n,)
    error: Array  # (n,) standard errors of the area under coverage over metres
    seconds: Array  # (n,)


def publish(folders: Sequence[Path], weights: Path = WEIGHTS) -> int:
    """Draw the curve of some runs, and ship the policy of the best one. Exit code 0; raises `ConfigError`."""
    if not folders:
        raise ConfigError("runs: none given, expected folders of runs of one algorithm")
    runs = [read_run(folder) for folder in folders]
    if len({(run.algorithm, run.score) for run in runs}) != 1:
        names = ", ".join(sorted({run.algorithm for run in runs}))
        raise ConfigError(f"runs: of {names}, expected one algorithm, all in tasks or none")
    best = max(runs, key=lambda run: run.area.max())
    target = weights / best.algorithm
    ship(best, target)
    draw(runs, target / "curve.png")
    hours = best.seconds[-1] / 3600.0
    print(f"{target}: the policy of {best.folder}, {best.area.max():.4f} on the validation split, {hours:.1f} h")
    return 0


def read_run(folder: Path) -> RunResult:
    """The figures of a run. Raises `ConfigError` for a folder without any."""
    try:
        fields = read_config(folder / "config.json")
        algorithm, score = str(fields["algorithm"]), "correct_over_steps" if fields.get("task") else "auc"
        with (folder / "evaluation.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        columns = [np.array([float(row[name] or "") for row in rows]) for name in (score, *COLUMNS)]
    except (OSError, KeyError, ValueError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise ConfigError(f"runs: {folder} is not a run folder: {reason}") from None
    if not rows:
        raise ConfigError(f"runs: {folder} has no evaluation yet")
    if not np.isfinite(columns).all():
        raise ConfigError(f"runs: {folder} has figures that are not finite")
    return RunResult(folder, algorithm, score, *columns)


def ship(run: RunResult, target: Path) -> None:
    """Copy the policy of a run and where it comes from; what was shipped before goes when all of it is there.

    Raises `ConfigError` for a policy that is too large for the repository or cannot be loaded, with nothing changed.
    """
    from mecp_env.core.files import write_atomic
    from mecp_env.learning.learned import load

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


def main(words: Sequence[str]) -> int:
    """Exit code 0, 2 for wrong input, or 130 after Ctrl-C."""
    return run_command(lambda: publish([Path(word) for word in words]))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
