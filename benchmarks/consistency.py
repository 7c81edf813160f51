"""Consistency of the filters on recorded drives with known correspondences: NEES over time, and the batch optimum.

Corners of each scan are those that the front end finds, with their joint covariance, and their true identities; one
that is off by more than 99.9 % of its covariance is left out. All filters, and `batch`, get the same motions and
measurements: prediction, update, new landmarks, and nothing else. Updates are iterated where the estimator does, else
what one linearisation neglects is noise; in `riekf, all iterated` they always are. The drives were recorded with the
true pose as the driver, one set for each model of the odometry: the paper's sigmas `per_metre`, `per_step` and
`linear`, and `skid_steer`, with wheels that slip in 1 % of the steps, of which the covariance knows nothing. There an
update asks first, as in the estimator, whether odometry has failed; `batch` knows the steps. Submaps have at most 10
landmarks, so that the map is divided.

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
from scipy.stats import chi2

from benchmarks import loop
from benchmarks.batch import optimum
from benchmarks.common import Figures, Options, estimate, ratio
from benchmarks.drives import mean_nees, nees, rms, sigma_ratio
from benchmarks.known_pairs import Sighting, filtered, in_order, measured
from benchmarks.plots import Panel, line_panels
from benchmarks.records import IN_MEMORY, Course, Records, on_drives
from benchmarks.tables import columns_of, sections, summary, table_of
from mecp_env.core.carriers import Array
from mecp_env.core.se2 import wrapped
from mecp_env.core.sensors import Odometry
from mecp_env.slam.config import KINDS, LocalisationConfig, SlamConfig
from mecp_env.slam.filters import Filter, make_filter
from mecp_env.slam.localisation import PoseGuard
from mecp_env.slam.messages import Belief, inflate

LAYOUT = "paper"
MODELS: dict[str, dict[str, Any]] = {  # fields of the odometry
    "per_metre": {},
    "per_step": {"reading": "per_step"},
    "linear": {"reading": "linear"},
    "skid_steer": {"preset": "skid_steer"},
}
SLIPS = ("skid_steer",)
SETS = dict.fromkeys(MODELS, 60)
OVER_TIME, COMPARED = "nees_over_time", ("nees", "landmark_nees", "landmark_rms_m")  # to BASE
BATCH, BASE, ALL = "batch", "riekf", "riekf, all iterated"
SUBMAP, MOMENTS, DRAWN = 10, 40, 5  # of a drive, for NEES over time; every fifth of them is drawn


def run(options: Options) -> Figures:
    """Results of every model and filter. Raises `OptionError` without GTSAM."""
    return {
        model: {name: summarise(own, rows[BATCH], rows[BASE]) for name, own in rows.items()}
        for model, rows in on_drives(compare, SETS, options).items()
    }


def compare(task: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each filter, and of the batch optimum, on one drive with an odometry."""
    model, seed = task
    fields = {"odometry": MODELS[model]} if MODELS[model] else {}
    drive = records.drive(Course(LAYOUT, seed, {"estimator": "truth", "max_steps": loop.MAX_STEPS, **fields}))
    record, path, corners = measured(drive, model in SLIPS)
    counts, best = dict[str, Figures](), None
    for name, kind in rows().items():
        found = make_filter(drive.slam.filter.model_copy(update={"kind": kind, "submap": SUBMAP}))
        beliefs = list(filtered(record, found, Correction(drive.slam, model in SLIPS, name == ALL)))
        if best is None:
            poses = np.array([belief.T_map_robot for belief in beliefs])
            best = optimum(record, poses, beliefs[-1].ids, beliefs[-1].p_map)
            counts[BATCH] = {
                "rmse_m": rms((best.T_map_robot - path)[:, :2]),
                "chi2_over_freedom": best.chi2 / best.freedom,
                **of_landmarks(best.p_map, best.covs, corners[best.ids]),
            }
        p_map, covs = in_order(found)
        own = {**of_path(beliefs, path), **of_landmarks(p_map, covs, corners[best.ids])}
        counts[name] = own | {"sigma_over_batch": sigma_ratio(covs, best.covs)}
    return counts


def rows() -> dict[str, str]:
    """The rows of the table, and the filter of each; first BASE, from which the batch optimum starts."""
    kinds = (BASE, *KINDS.ours, *KINDS.others)
    return {**{kind: kind for kind in kinds}, ALL: BASE}


class Correction:
    """An update as the estimator does it: iterated where the prediction is wide, else with what one linearisation
    neglects as noise; and, with slip, odometry doubted.
    """

    def __init__(self, slam: SlamConfig, slips: bool, always: bool = False) -> None:
        self.sharp, self.always = slam.association.is_sharp, always
        local = slam.localisation if slips else LocalisationConfig(explained_share=0.0)
        self.guard = PoseGuard(local, 0.0, slam.association)

    def __call__(self, found: Filter, sighting: Sighting, odometry: Odometry | None) -> None:
        """Update a filter by known landmarks; without any, what was driven counts at the next update."""
        if odometry is not None:
            self.guard.follow(odometry)
        (z, R, ids), belief = sighting, found.belief()
        iterate = self.always or not self.sharp(belief)
        if not iterate:
            x, y, heading = belief.pose_cov.diagonal().tolist()
            R = np.empty_like(R)
            inflate(sighting.R, z, 0.5 * (x + y), heading, R)
        self.guard.update(found, z, R, ids, iterate)
        self.guard.travelled = self.guard.turned = 0.0


def of_path(beliefs: list[Belief], path: Array) -> Figures:
    """NEES of the pose and its error."""
    errors = np.array([belief.T_map_robot for belief in beliefs]) - path
    errors[:, 2] = wrapped(errors[:, 2])
    over_time = nees(errors, np.array([belief.pose_cov for belief in beliefs]))
    moments = np.linspace(0, len(over_time) - 1, MOMENTS + 1).round().astype(int)[1:]
    mean = {"nees": float(over_time.mean()), "rmse_m": rms(errors[:, :2])}
    return mean | {OVER_TIME: over_time[moments].tolist()}


def of_landmarks(p_map: Array, covs: Array, corners: Array) -> Figures:
    """NEES and error of landmarks (m,2) with covariances (m,2,2)."""
    return {"landmark_nees": mean_nees(p_map - corners, covs), "landmark_rms_m": rms(p_map - corners)}


def summarise(own: list[Figures], best: list[Figures], base: list[Figures]) -> Figures:
    """Results of one filter over all drives with a model, each with its 95 % interval."""
    plain = [[{key: run[key] for key in run if key != OVER_TIME} for run in runs] for runs in (own, best, base)]
    of, of_best, of_base = map(columns_of, plain)
    figures: Figures = {**summary(plain[0], of), "over_batch": ratio(of["landmark_rms_m"], of_best["landmark_rms_m"])}
    if own is not best:
        over_time = np.array([run[OVER_TIME] for run in own])
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
        head = "The mean of {} NEES of a pose is in [{:.2f}, {:.2f}] in 95 %.".format(n, *band(n))
        said = f" `batch`: chi2 per degree of freedom {rows[BATCH]['chi2_over_freedom']['value']:.3f}."
        parts[f"{model} ({n} drives)"] = f"{head}{said}\n\n{table_of('filter', columns, rows)}"
    return sections(parts)


def figure(figures: Figures) -> Figure:
    """NEES over time of each filter and model, with the band of a consistent filter."""
    drawn, panels = range(DRAWN - 1, MOMENTS, DRAWN), {}
    for model, rows in figures.items():
        n = rows[BASE]["nees"]["n"]
        consistent = dict(zip(("value", "low", "high"), (3.0, *band(n)), strict=True))
        lines = {name: [row[OVER_TIME][str(k)] for k in drawn] for name, row in rows.items() if name != BATCH}
        lines = {"95 % of a consistent filter": [consistent] * len(drawn), **lines}
        panels[f"{model} ({n} drives): share of the drive"] = Panel([f"{(k + 1) / MOMENTS:g}" for k in drawn], lines)
    return line_panels(panels, "mean NEES of the pose, no unit", log=True)
