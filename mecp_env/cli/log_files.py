"""What `mecp-env slam` shows and keeps of a run on a log.

What `mecp-env slam` prints of the calibration of a robot.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from mecp_env.core.carriers import Array
from mecp_env.core.files import naming, sanitised, write_atomic
from mecp_env.core.se2 import between, composed
from mecp_env.evaluation.calibration import Calibration, Estimate
from mecp_env.evaluation.log_run import LogRun
from mecp_env.evaluation.trajectory import align, tum
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.logs import Log
from mecp_env.render.figures import map_figure, save
from mecp_env.render.film import Film
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.rerun_log import RerunLog
from mecp_env.render.screen import thumbnail
from mecp_env.render.shapes import SceneView
from mecp_env.slam.output import SlamOutput

UNITS = {  # of the fields of a calibration; the others have none
    "turn_bias_deg_per_m": "deg per m",
    "x_m": "m",
    "heading_deg": "deg",
    "distance_sigma_m": "m per sqrt(m)",
    "distance_sigma_turning_m": "m per sqrt(rad)",
    "turn_sigma_deg": "deg per sqrt(m)",
    "turn_sigma_turning_deg": "deg per sqrt(rad)",
    "range_sigma_m": "m",
}
COLUMNS = {"field": "left", "value": "right", "sigma": "right", "unit": "left", "source": "left"}


def print_calibration(calibration: Calibration | None) -> None:
    """Print each value with its standard deviation and source, and why defaults are used; nothing without one."""
    if calibration is None:
        return
    title = f"calibration by {calibration.registered} of {calibration.tried} motions between scans"
    table = Table(title=title, title_justify="left")
    for column, side in COLUMNS.items():
        table.add_column(column, justify="right" if side == "right" else "left")
    for name, estimate in calibration.estimates.items():
        table.add_row(*_row(name, estimate))
    if calibration.range_noise_m is not None:
        table.add_row("range noise on straight walls", f"{calibration.range_noise_m:.4f}", "", "m", "measured")
    console = Console()
    console.print(table)
    for note in calibration.notes:
        console.print(f"note: {sanitised(note)}", markup=False)


def _row(name: str, estimate: Estimate) -> tuple[str, str, str, str, str]:
    sigma = "" if estimate.sigma is None else f"{estimate.sigma:.4f}"
    return name, f"{estimate.value:.4f}", sigma, UNITS.get(name, ""), estimate.source


FILES = (  # what a run leaves behind; truth.tum only where the log has a reference path
    *("map.png", "run.gif", "replay.html", "belief.yaml", "belief.pgm", "belief.svg"),
    *("metrics.json", "trajectory.tum", "truth.tum", "config.json", "trajectory_final.tum", "landmarks_final.csv"),
    *("map_final.png", "belief_final.yaml", "belief_final.pgm"),
)
FILM_SIZE = (800, 640)
FRAMES = 150
BAR_WIDTH = 20
FINAL = "final_"  # before the names of the figures of the smoothed path
EVERY = 10  # scans between two updates of the bar


class LogFiles:
    """The film and the path of a run in progress, and the files at its end."""

    def __init__(self, log: Log, planned: int, rerun: RerunLog | None = None) -> None:
        self.log, self.rerun = log, rerun
        self.film = Film(every=max(1, planned // FRAMES))
        self.path: list[Array] = []  # (2,) m, map frame
        self.recorder = Recorder()

    def look(self, output: SlamOutput, row: int) -> None:
        """Keep what belongs to one scan, that of record `row` of the log."""
        self.path.append(output.belief.T_map_robot[:2].copy())
        self.film.offer(len(self.path) - 1, lambda: self._frame(output))
        view = _view(output, np.array(self.path[-1:]), np.empty((0, 2)), self.log.name)
        seconds = float(self.log.t[row] - self.log.t[0])
        self.recorder.look(view, seconds=seconds)
        if self.rerun is not None:
            self.rerun.look(view, seconds=seconds)

    def _frame(self, output: SlamOutput) -> Any:
        rooms, doors = len(output.graph.rooms), len(output.graph.doors)
        lost = "" if output.localised else ", the pose is searched for"
        caption = f"scan {len(self.path)}: {rooms} rooms, {doors} doors, {len(output.belief.ids)} landmarks{lost}"
        view = _view(output, np.array(self.path), np.empty((0, 2)), self.log.name)
        return thumbnail(view, FILM_SIZE, self.log.name, caption, scan=True)

    def keep(self, folder: Path, run: LogRun, recipe: Mapping[str, Any]) -> dict[str, Any]:
        """Write `FILES` into `folder`; the metrics."""
        folder.mkdir(parents=True, exist_ok=True)
        metrics, reference = run.metrics(), _reference(run)
        for name, data in (("metrics.json", metrics), ("config.json", recipe)):  # data first: a full disk keeps it
            write_atomic(folder / name, (json.dumps(data, indent=2) + "\n").encode())
        write_atomic(folder / "trajectory.tum", tum(run.t, run.T_map_robot).encode())
        write_atomic(folder / "trajectory_final.tum", tum(run.t, run.T_final_robot).encode())
        (folder / "truth.tum").unlink(missing_ok=True)
        if len(reference):
            known = np.isfinite(reference[:, 0])
            write_atomic(folder / "truth.tum", tum(run.t[run.scored][known], reference[known]).encode())
        view = _view(run.output, run.T_map_robot[run.scored, :2], reference[:, :2], _caption(self.log.name, metrics))
        self._keep_pictures(folder, run, view, _caption(run.ended, metrics))
        _keep_final(folder, run, self.log.name, metrics)
        return metrics

    def _keep_pictures(self, folder: Path, run: LogRun, view: SceneView, caption: str) -> None:
        with naming(folder / "belief.pgm"):
            save_map_server(run.output.grid, folder / "belief")
        with naming(folder / "belief.svg"):
            save_svg(run.output.grid, folder / "belief.svg")
        with naming(folder / "map.png"):
            save(map_figure(view), folder / "map.png")
        self.film.frames.append(self._frame(run.output))
        with naming(folder / "run.gif"):
            self.film.save(folder / "run.gif")
        write_page(self.recorder.run(self.log.name, caption), folder / "replay.html")


def _keep_final(folder: Path, run: LogRun, name: str, metrics: Mapping[str, Any]) -> None:
    """Write landmarks, grid and picture of the smoothed path."""
    output, path = run.final_output, run.T_final_robot[run.scored, :2]
    output.export(landmarks=folder / "landmarks_final.csv", grid=folder / "belief_final.yaml")
    errors = {key.removeprefix(FINAL): value for key, value in metrics.items() if key.startswith(FINAL)}
    reference = _reference(replace(run, T_map_robot=run.T_final_robot))
    view = _view(output, path, reference[:, :2], _caption(f"{name}, final trajectory", {**metrics, **errors}))
    with naming(folder / "map_final.png"):
        save(map_figure(view), folder / "map_final.png")


def _reference(run: LogRun) -> Array:
    """(n,3) the reference path from the first known pose on, laid over the estimated one; none, or nan, without.

    It is that of the robot as the estimator knows it.
    """
    if run.T_ref_robot is None or not run.localised.any():
        return np.empty((0, 3))
    T_ref, T_map = run.T_ref_robot[run.scored], run.T_map_robot[run.scored]
    known = np.isfinite(T_ref[:, 0])
    if not known.any():
        return np.empty((0, 3))
    to_robot = between(run.T_robot_frame, np.zeros(3))
    T_ref = composed(T_ref, np.broadcast_to(to_robot, T_ref.shape))
    return composed(align(T_map[known, :2], T_ref[known, :2]), T_ref)


def _view(output: SlamOutput, path: Array, reference: Array, title: str) -> SceneView:
    """One moment of a log, in the map frame."""
    frames = np.empty((0, 2, 2)), output.belief.T_map_robot, np.zeros(3)
    return SceneView(*frames, reference, path, output, title=title)


def _caption(name: str, metrics: Mapping[str, Any]) -> str:
    """What the figure says of a run: as far as there are a reference and relations."""
    parts = (
        "{landmarks} landmarks, {rooms} rooms, {doors} doors",
        "trajectory error {ate_m:.2f} m",
        "relations {relations_m:.3f} m, {relations_deg:.2f} deg",
    )
    return "    ".join([name, *_filled(parts, metrics)])


def _filled(forms: Iterable[str], metrics: Mapping[str, Any]) -> Iterator[str]:
    """Those of the formats whose metrics there are."""
    for form in forms:
        with suppress(KeyError):
            yield form.format(**metrics)


class MappingBar(Progress):
    """A bar of the scans, with the time that is left and what has been mapped."""

    def __init__(self, name: str, planned: int, console: Console | None = None) -> None:
        times = MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()
        super().__init__(BarColumn(BAR_WIDTH), *times, TextColumn("{task.description}"), console=console)
        self.console.print(f"mapping {sanitised(name)}", style="bold", markup=False)
        self.task, self.scans, self.planned = self.add_task("", total=planned), 0, planned

    def show(self, output: SlamOutput) -> None:
        """Bring the bar up to date, every few scans."""
        self.scans += 1
        if self.scans % EVERY == 0 or self.scans == self.planned:
            said = f"rooms {len(output.graph.rooms)} doors {len(output.graph.doors)}"
            self.update(self.task, completed=self.scans, description=said)


ROWS = (  # shown name, format; left out where a metric is missing
    ("scans", "{scans} over {seconds:.0f} s and {metres:.0f} m, {log_share:.0%} of the log"),
    ("map", "{landmarks} landmarks ({landmarks_dropped} dropped), {rooms} rooms, {doors} doors"),
    ("scans with a polygon", "{polygon_share:.1%}"),
    ("scans with a known pose", "{localised_share:.1%}"),
    ("trajectory error", "RMSE {ate_m:.3f} m, {ate_deg:.2f} deg; dead reckoning {dead_reckoning_ate_m:.3f} m"),
    ("  final", "RMSE {final_ate_m:.3f} m, {final_ate_deg:.2f} deg"),
    ("relations", "mean {relations_m:.3f} m, {relations_deg:.2f} deg ({relations} relations)"),
    (
        "  that hit two scans",
        "mean {relations_at_scans_m:.3f} m, {relations_at_scans_deg:.2f} deg ({relations_at_scans})",
    ),
    ("relations, final", "mean {final_relations_m:.3f} m, {final_relations_deg:.2f} deg"),
    ("  that hit two scans", "mean {final_relations_at_scans_m:.3f} m, {final_relations_at_scans_deg:.2f} deg"),
    ("final trajectory", "{final_steps} steps, {final_s:.1f} s"),
    ("time per scan", "median {ms_per_scan_median:.1f} ms, mean {ms_per_scan_mean:.1f} ms"),
)


def print_result(metrics: Mapping[str, Any], folder: Path) -> None:
    """Print the figures of a run, what was skipped or repaired in the log, and where the files are."""
    table = Table(title=sanitised(f"log {metrics['ended']}"), show_header=False, title_justify="left")
    for name, form in ROWS:
        for value in _filled([form], metrics):
            table.add_row(name, value)
    console = Console()
    console.print(table)
    for what, count in metrics["counts"].items():
        console.print(f"counted: {count} {what}", markup=False)
    for note in metrics["notes"]:
        console.print(f"note: {sanitised(note)}", markup=False)
    there = [name for name in FILES if (folder / name).exists()]
    console.print(f"{', '.join(there)} in {sanitised(str(folder))}/", markup=False)
