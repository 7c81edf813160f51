"""Runs of one algorithm, several seeds: draw their learning curve, and ship the best policy.

`python -m benchmarks.publish_policy runs/maskable_ppo-0 runs/maskable_ppo-1 runs/maskable_ppo-2`
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from mecp_env.cli.base import run_command
from mecp_env.core.carriers import Array
from mecp_env.core.errors import ConfigError
from mecp_env.core.files import write_atomic
from mecp_env.learning.config import read_config
from mecp_env.policies.registry import WEIGHTS
from mecp_env.render.figures import save
from mecp_env.render.palette import MARKERS

SHIPPED = ("config.json", "run.json", "evaluation.csv", "progress.csv", "policy.json")  # the last names the weights
SCORES = {"auc": "area under coverage over metres", "correct_over_steps": "correct coverage over steps"}
MOST_BYTES = 1_900_000  # of weights in the repository


class RunResult(NamedTuple):
    """The results of a run on the validation split."""

    folder: Path
    kind: tuple[str, str]  # the algorithm, and the metric by which the best policy is chosen
    columns: Array  # (4,n) that metric, decisions, standard errors of the area, seconds


def publish(folders: Sequence[Path], weights: Path = WEIGHTS) -> int:
    """Draw the curve of some runs, and ship the policy of the best one. Exit code 0; raises `ConfigError`."""
    if not folders:
        raise ConfigError("runs: none given, expected folders of runs of one algorithm")
    runs = [read_run(folder) for folder in folders]
    if len({run.kind for run in runs}) != 1:
        names = ", ".join(sorted({run.kind[0] for run in runs}))
        raise ConfigError(f"runs: of {names}, expected one algorithm, all in tasks or none")
    best = max(runs, key=lambda run: run.columns[0].max())
    target = weights / best.kind[0]
    ship(best.folder, target)
    save(curve(runs), target / "curve.png")
    score, hours = best.columns[0].max(), best.columns[3, -1] / 3600.0
    print(f"{target}: the policy of {best.folder}, {score:.4f} on the validation split, {hours:.1f} h")
    return 0


def read_run(folder: Path) -> RunResult:
    """The figures of a run. Raises `ConfigError` for a folder without any."""
    try:
        fields = read_config(folder / "config.json")
        algorithm, score = str(fields["algorithm"]), "correct_over_steps" if fields.get("task") else "auc"
        with (folder / "evaluation.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        columns = [[float(row[name] or "") for row in rows] for name in (score, "decisions", "auc_error", "seconds")]
    except (OSError, KeyError, ValueError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        raise ConfigError(f"runs: {folder} is not a run folder: {reason}") from None
    if not rows or not np.isfinite(columns).all():
        raise ConfigError(f"runs: {folder} has no evaluation yet, or figures that are not finite")
    return RunResult(folder, (algorithm, score), np.array(columns))


def ship(folder: Path, target: Path) -> None:
    """Copy the policy of a run and where it comes from; what was shipped before goes when all of it is there.

    Raises `ConfigError` for a policy that is too large for the repository or cannot be loaded, with nothing changed.
    """
    from mecp_env.learning.learned import load

    if target.resolve() == folder.resolve():
        raise ConfigError(f"runs: {folder} is where the policy would be put")
    load(folder)
    weights = str(read_config(folder / SHIPPED[-1])["file"])
    whole = {name: (folder / name).read_bytes() for name in (weights, *SHIPPED)}
    if len(whole[weights]) > MOST_BYTES:
        raise ConfigError(f"{weights}: {len(whole[weights])} bytes, at most {MOST_BYTES}; a smaller network.width?")
    for name, data in whole.items():
        write_atomic(target / name, data)
    for old in target.glob("policy-*.safetensors"):
        if old.name != weights:
            old.unlink()


def curve(runs: list[RunResult]) -> Figure:
    """The metric over the decisions: one line per run, with a standard error where that is known."""
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes, (algorithm, score) = figure.add_subplot(), runs[0].kind
    for run, marker in zip(runs, cycle(MARKERS)):
        area, decisions, error, _ = run.columns
        (line,) = axes.plot(decisions, area, marker=marker, markersize=4, label=run.folder.name)
        if score == "auc":
            axes.fill_between(decisions, area - error, area + error, alpha=0.15, color=line.get_color())
    axes.axhline(runs[0].columns[0, 0], color="0.5", linestyle="--", linewidth=1, label="untrained (its prior)")
    axes.set(xlabel="decisions", ylabel=f"{SCORES[score]}, validation")
    axes.set_title(f"{algorithm}: band is one standard error over the buildings", fontsize=10)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    sys.exit(run_command(lambda: publish([Path(word) for word in sys.argv[1:]])))
