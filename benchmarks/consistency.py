"""Consistency of the filters on recorded drives with known correspondences: NEES over time, and the batch optimum.

Corners of each scan are those that the front end finds, with their joint covariance, and their true identities; one
that is off by more than 99.9 % of its covariance is left out. All filters, and `batch`, get the same motions and
measurements: prediction, update, new landmarks, and nothing else. Updates are iterated where the estimator does, in
`riekf, all iterated` always. The drives were recorded with the true pose as the driver, one set for each model of the
odometry: the paper's sigmas `per_metre`, `per_step` and `linear`, and `skid_steer`, with wheels that slip in 1 % of the
steps, of which the covariance knows nothing. There an update asks first, as in the estimator, whether odometry has
failed; `batch` knows the steps. Submaps have at most 10 landmarks, so that the map is divided.

`nees` is that of the pose (3 expected), the mean over a drive; `landmark_nees` that of the landmarks at the end (2
expected). `landmark_rms_m` is the distance of the landmarks from the true corners at the end; `over_batch` is the sum
of these over all drives divided by that of `batch`, and `sigma_over_batch` the mean over drives of the median ratio of
a landmark's sigma to that of `batch`. `rmse_m` is that of the pose. The other columns are mean differences to `riekf`
on the same drives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from scipy.stats import chi2

from benchmarks import loop
from benchmarks.batch import Optimum, optimum
from benchmarks.common import Figures, Gate, Options, estimate, ratio
from benchmarks.errors import mean_nees, nees, rms, sigma_ratio
from benchmarks.known_pairs import Sighting, filtered, in_order, measured
from benchmarks.plots import DASHES, GREYS
from benchmarks.records import IN_MEMORY, Course, Records, on_drives
from benchmarks.tables import columns_of, means, sections, table_of
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import wrap_angle
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import KINDS, LocalisationConfig, SlamConfig
from mecp_env.slam.filters import Filter, make_filter
from mecp_env.slam.localisation import PoseGuard
from mecp_env.slam.messages import Belief

LAYOUT = "paper"
MODELS: dict[str, dict[str, Any]] = {  # fields of the odometry
    "per_metre": {},
    "per_step": {"reading": "per_step"},
    "linear": {"reading": "linear"},
    "skid_steer": {"preset": "skid_steer"},
}
SLIPS = ("skid_steer",)
SETS = {"per_metre": 60, "per_step": 60, "linear": 60, "skid_steer": 60}
OVER_TIME, COMPARED = "nees_over_time", ("nees", "landmark_nees", "landmark_rms_m")  # to BASE
BATCH, BASE, ALL = "batch", "riekf", "riekf, all iterated"
SUBMAP, MOMENTS = 10, 40  # of a drive, for NEES over time

GATES = (
    Gate("per_metre/riekf/nees", "bound", 4.5),
    Gate("per_metre/riekf/over_batch", "bound", 1.1),
    Gate("per_metre/riekf_submaps/over_batch", "bound", 1.1),
    Gate("per_metre/fej/over_batch", "bound", 1.1),
)


def run(options: Options) -> Figures:
    """Results of every model and filter. Raises `OptionError` without GTSAM."""
    return {
        model: {name: summarise(own, rows[BATCH], rows[BASE]) for name, own in rows.items()}
        for model, rows in on_drives(compare, SETS, options).items()
    }


def course(model: str, seed: int) -> Course:
    """What is driven with an odometry."""
    fields = {"odometry": MODELS[model]} if MODELS[model] else {}
    return Course(LAYOUT, seed, {"estimator": "truth", "max_steps": loop.MAX_STEPS, **fields})


def compare(task: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each filter, and of the batch optimum, on one drive."""
    model, seed = task
    drive = records.drive(course(model, seed))
    record, path, corners = measured(drive, model in SLIPS)
    counts, best = dict[str, Figures](), None
    for name, kind in rows().items():
        found = make_filter(drive.slam.filter.model_copy(update={"kind": kind, "submap": SUBMAP}))
        correct = Correction(drive.slam, model in SLIPS, name == ALL)
        beliefs = list(filtered(record, found, correct))
        if best is None:
            poses = np.array([belief.T_map_robot for belief in beliefs])
            best = optimum(record, poses, beliefs[-1].ids, beliefs[-1].p_map)
            counts[BATCH] = of_batch(best, path, corners[best.ids])
        counts[name] = of_filter(beliefs, in_order(found), path, corners[best.ids])
        counts[name]["sigma_over_batch"] = sigma_ratio(in_order(found)[1], best.covs)
    return counts


def rows() -> dict[str, str]:
    """The rows of the table, and the filter of each; first BASE, from which the batch optimum starts."""
    kinds = (BASE, *KINDS.ours, *KINDS.others)
    return {**{kind: kind for kind in kinds}, ALL: BASE}


class Correction:
    """An update as the estimator does it: iterated where the prediction is wide, and, with slip, odometry doubted."""

    def __init__(self, slam: SlamConfig, slips: bool, always: bool = False) -> None:
        self.sharp, self.always = slam.association.is_sharp, always
        local = slam.localisation if slips else LocalisationConfig(explained_share=0.0)
        self.guard = PoseGuard(local, 0.0, 0.0)

    def __call__(self, found: Filter, sighting: Sighting, odometry: Odometry | None) -> None:
        """Update a filter by known landmarks; without any, what was driven counts at the next update."""
        if odometry is not None:
            self.guard.follow(odometry)
        iterate = self.always or not self.sharp(found.belief())
        self.guard.update(found, sighting.z, sighting.R, sighting.ids, iterate)
        self.guard.travelled = self.guard.turned = 0.0


def of_filter(beliefs: list[Belief], landmarks: tuple[Array, Array], path: Array, corners: Array) -> Figures:
    """Counts of one filter."""
    errors = np.array([belief.T_map_robot for belief in beliefs]) - path
    errors[:, 2] = [wrap_angle(error) for error in errors[:, 2].tolist()]
    covs = np.array([belief.pose_cov for belief in beliefs])
    over_time = nees(errors, covs)
    moments = np.linspace(0, len(over_time) - 1, MOMENTS + 1).round().astype(int)[1:]
    return {
        "nees": float(over_time.mean()),
        OVER_TIME: over_time[moments].tolist(),
        "rmse_m": rms(errors[:, :2]),
        **of_landmarks(*landmarks, corners),
    }


def of_batch(best: Optimum, path: Array, corners: Array) -> Figures:
    """Counts of the batch optimum."""
    return {
        "rmse_m": rms((best.T_map_robot - path)[:, :2]),
        "chi2_over_freedom": best.chi2 / best.freedom,
        **of_landmarks(best.p_map, best.covs, corners),
    }


def of_landmarks(p_map: Array, covs: Array, corners: Array) -> Figures:
    """NEES and error of landmarks (m,2) with covariances (m,2,2)."""
    return {"landmark_nees": mean_nees(p_map - corners, covs), "landmark_rms_m": rms(p_map - corners)}


def summarise(own: list[Figures], best: list[Figures], base: list[Figures]) -> Figures:
    """Results of one filter over all drives with a model, each with its 95 % interval."""
    of, of_best, of_base = (
        columns_of([{name: value for name, value in one.items() if name != OVER_TIME} for one in rows])
        for rows in (own, best, base)
    )
    figures: Figures = {**means(of, *of), "over_batch": ratio(of["landmark_rms_m"], of_best["landmark_rms_m"])}
    if own is not best:
        over_time = np.array([one[OVER_TIME] for one in own])
        figures[OVER_TIME] = {str(k): estimate(column) for k, column in enumerate(over_time.T)}
        figures |= {f"{name}_minus_{BASE}": estimate(of[name] - of_base[name]) for name in COMPARED}
    return figures


def band(runs: int) -> tuple[float, float]:
    """The 95 % interval of the mean NEES of the pose in so many runs."""
    low, high = chi2.interval(0.95, 3 * runs)
    return float(low) / runs, float(high) / runs


def report(figures: Figures) -> str:
    """Per model a table with one row per filter."""
    columns = ["nees", "landmark_nees", "landmark_rms_m", "over_batch", "sigma_over_batch", "rmse_m"]
    columns += [f"{name}_minus_{BASE}" for name in COMPARED]
    parts = {}
    for model, rows in figures.items():
        n = rows[BASE]["nees"]["n"]
        low, high = band(n)
        head = f"The mean of {n} NEES of a pose is in [{low:.2f}, {high:.2f}] in 95 %."
        said = f" `batch`: chi2 per degree of freedom {rows[BATCH]['chi2_over_freedom']['value']:.3f}."
        parts[f"{model} ({n} drives)"] = f"{head}{said}\n\n{table_of('filter', columns, rows)}"
    return sections(parts)


def figure(figures: Figures) -> Figure:
    """NEES over time of each filter and model, with the band of a consistent filter."""
    across = min(len(figures), 2)
    down = -(-len(figures) // across)
    drawn = Figure(figsize=(4.2 * across, 3.4 * down + 0.6), layout="constrained")
    all_axes = drawn.subplots(down, across, sharey=True, squeeze=False).ravel()
    for axes, (model, rows) in zip(all_axes, figures.items(), strict=False):
        n = rows[BASE]["nees"]["n"]
        at = np.arange(1, MOMENTS + 1) / MOMENTS
        axes.fill_between(at, *band(n), color="0.85", label="95 % of a consistent filter")
        lines = {name: row[OVER_TIME] for name, row in rows.items() if name != BATCH}
        for k, (name, line) in enumerate(lines.items()):
            values = [line[str(moment)]["value"] for moment in range(MOMENTS)]
            axes.plot(at, values, label=name, linestyle=DASHES[k], color=GREYS[k], linewidth=1.2)
        axes.set(title=f"{model} ({n} drives)", xlabel="share of the drive", yscale="log")
        axes.grid(alpha=0.3)
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
    for axes in all_axes[len(figures) :]:
        axes.remove()
    for axes in all_axes[::across]:
        axes.set_ylabel("mean NEES of the pose, no unit")
    handles = all_axes[0].get_legend_handles_labels()
    drawn.legend(*handles, loc="outside lower center", ncols=4, frameon=False)
    return drawn
