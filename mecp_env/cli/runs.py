"""What a run shows while it goes, and what it leaves behind: an exploration, or the estimator on a log."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, TimeElapsedColumn
from rich.table import Table

from mecp_env.cli.base import as_note, echo
from mecp_env.core.carriers import Array, Bytes
from mecp_env.core.files import naming, sanitised, write_atomic
from mecp_env.core.se2 import between, compose, composed, inverse
from mecp_env.env import MecpEnv
from mecp_env.evaluation.log_run import LogRun
from mecp_env.evaluation.trajectory import align, tum
from mecp_env.floorplans.exporters import save_map_server, save_svg
from mecp_env.logs import Log
from mecp_env.planning.breadth_first import BreadthFirst
from mecp_env.render.figures import Moment, curves_figure, moment_of, save
from mecp_env.render.progress import Bar
from mecp_env.render.replay import Recorder, write_page
from mecp_env.render.rerun_log import RerunLog
from mecp_env.render.screen import Film, Screen, map_picture, thumbnail
from mecp_env.render.shapes import SceneView, filled, summary
from mecp_env.slam.output import SlamOutput
from mecp_env.wrappers import GoalActions, Step

FILES = (  # what a run leaves behind
    *("map.png", "curves.png", "run.gif", "replay.html", "belief.yaml", "belief.pgm", "belief.svg"),
    *("metrics.json", "trajectory.tum", "truth.tum", "config.json"),
)
LOG_FILES = (  # that of a log; truth.tum only where the log has a reference path
    *(name for name in FILES if name != "curves.png"),
    *("trajectory_final.tum", "landmarks_final.csv", "map_final.png", "belief_final.yaml", "belief_final.pgm"),
)
FILM_WIDTH = 960  # px
FILM_SIZE = (800, 640)  # px, of a log
FRAMES = 150  # of a log
FINAL = "final_"  # before the names of the figures of the smoothed path
SHARE = BarColumn(6), TimeElapsedColumn()  # with what has been found they fit into 80 columns
FOUND = (
    "rooms {rooms_found:.0f}/{rooms:.0f} doors {doors_found:.0f}/{doors:.0f} seen {coverage:.1%} "
    "error {error_cm:.1f} cm {speed:,.0f} steps/s"
)
AT_SCANS = "  that hit two scans"
ROWS = (  # shown name, format; left out where a metric is missing
    ("rooms found", "{rooms_found:.0f} of {rooms:.0f}, {rooms_false:.0f} false"),
    ("doors found", "{doors_found:.0f} of {doors:.0f}, {doors_false:.0f} false"),
    ("free area seen", "{coverage:.1%}"),
    ("grid IoU with the truth", "{grid_iou:.3f}"),
    ("pose error", "RMSE {pose_rmse_m:.3f} m, final {pose_error_final_m:.3f} m"),
    ("pose NEES", "{nees_mean:.2f} (3 expected)"),
    ("association", "precision {association_precision:.4f}, recall {association_recall:.4f}"),
    ("landmarks", "{landmarks:.0f}, of no corner {landmarks_false:.0f}, duplicates {duplicates:.0f}"),
    ("map error", "RMSE {map_rmse_m:.3f} m"),
    ("way", "{metres:.0f} m in {periods:.0f} steps, contacts {contacts:.0f}"),
    ("speed", "{steps_per_s:,.0f} steps/s"),
    ("scans", "{scans} over {seconds:.0f} s and {metres:.0f} m, {log_share:.0%} of the log"),
    ("map", "{landmarks} landmarks ({landmarks_dropped} dropped), {rooms} rooms, {doors} doors"),
    ("scans with a polygon", "{polygon_share:.1%}"),
    ("scans with a known pose", "{localised_share:.1%}"),
    ("trajectory error", "RMSE {ate_m:.3f} m, {ate_deg:.2f} deg; dead reckoning {dead_reckoning_ate_m:.3f} m"),
    ("  final", "RMSE {final_ate_m:.3f} m, {final_ate_deg:.2f} deg"),
    ("relations", "mean {relations_m:.3f} m, {relations_deg:.2f} deg ({relations} relations)"),
    (AT_SCANS, "mean {relations_at_scans_m:.3f} m, {relations_at_scans_deg:.2f} deg ({relations_at_scans})"),
    ("relations, final", "mean {final_relations_m:.3f} m, {final_relations_deg:.2f} deg"),
    (AT_SCANS, "mean {final_relations_at_scans_m:.3f} m, {final_relations_at_scans_deg:.2f} deg"),
    ("final trajectory", "{final_steps} steps, {final_s:.1f} s"),
    ("time per scan", "median {ms_per_scan_median:.1f} ms, mean {ms_per_scan_mean:.1f} ms"),
)


def print_figures(title: str, metrics: Mapping[str, Any], folder: Path) -> None:
    """Print the figures of a run, what was skipped or repaired in its log, and where its files are."""
    table = Table(title=sanitised(title), show_header=False, title_justify="left")
    for row in filled(ROWS, metrics):
        table.add_row(*row)
    Console().print(table)
    counts = [f"counted: {count} {what}" for what, count in metrics.get("counts", {}).items()]
    there = [name for name in dict.fromkeys((*FILES, *LOG_FILES)) if (folder / name).exists()]
    notes = list(map(as_note, metrics.get("notes", ())))
    for said in (*counts, *notes, f"{', '.join(there)} in {folder}/"):
        Console().print(sanitised(said), markup=False)


def _keep_data(folder: Path, metrics: Mapping[str, Any], recipe: Mapping[str, Any], paths: Mapping[str, Any]) -> None:
    """Write what cannot be made again from other files; it comes first, so that a full disk keeps it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in (("metrics.json", metrics), ("config.json", recipe)):
        write_atomic(folder / name, (json.dumps(data, indent=2) + "\n").encode())
    for name, (times, poses) in paths.items():
        write_atomic(folder / name, tum(times, poses).encode())


def _keep_pictures(folder: Path, output: SlamOutput, view: SceneView, film: Film) -> None:
    with naming(folder / "belief.pgm"):
        save_map_server(output.grid, folder / "belief")
    with naming(folder / "belief.svg"):
        save_svg(output.grid, folder / "belief.svg")
    _keep_map(folder / "map.png", view)
    with naming(folder / "run.gif"):
        film.save(folder / "run.gif")


def _keep_map(path: Path, view: SceneView) -> None:
    with naming(path):
        Image.fromarray(map_picture(view)).save(path)


class Enough(Exception):
    """An exploration need not go on."""


@dataclass
class Run:
    """An exploration in progress, and what is kept of each of its steps."""

    env: MecpEnv
    seed: int
    recorder: Recorder | None = field(default_factory=Recorder)  # None: no replay
    rerun: RerunLog | None = None  # the recording of the rerun viewer, where one is wanted
    film: Film = field(default_factory=Film)
    screen: Screen | None = None  # of the film; made when the building is known
    estimated: list[Array] = field(default_factory=list)  # (3,) T_map_robot as believed, one a step
    true: list[Array] = field(default_factory=list)  # (3,) T_map_robot in truth
    moments: list[Moment] = field(default_factory=list)  # what the curves show
    seconds: list[float] = field(default_factory=list)  # processor time of each step
    ended: str = "interrupted"
    view: SceneView = field(init=False)  # of the last step

    @property
    def steps(self) -> int:
        return max(len(self.estimated) - 1, 0)

    @property
    def steps_per_s(self) -> float:
        """By the median step: some load functions first, or search a way."""
        return 1.0 / statistics.median(self.seconds) if self.seconds else 0.0

    def explore(self, enough: Callable[[Run], object] = lambda _: False) -> None:
        """Explore to the end, or until it is `enough`, as it is asked after every step and once before the first."""

        begun = 0.0

        def look(step: Step | None = None) -> None:
            nonlocal begun
            self.seconds += [time.thread_time() - begun] if step else []
            self.look(step[4] if step else None)
            if enough(self):
                raise Enough
            begun = time.thread_time()

        policy, goals = BreadthFirst(), GoalActions(self.env, callback=look)
        observation, _ = goals.reset(seed=self.seed)
        terminated = truncated = False
        with suppress(Enough):
            look()
            while not (terminated or truncated):
                action = policy.act(observation, goals.action_masks())
                observation, _, terminated, truncated, info = goals.step(action)
            self.ended = "complete" if terminated else "diverged" if info["diverged"] else "out of steps"

    def look(self, info: dict[str, Any] | None = None) -> None:
        """Keep what belongs to the present step."""
        view = self.view = self.env.view()
        self.estimated.append(view.slam_output.belief.T_map_robot.copy())
        self.true.append(compose(inverse(view.T_world_map), view.T_world_robot))
        self.moments.append(moment_of(view))
        for record in (self.recorder, self.rerun):
            if record is not None:
                record.look(view, info)
        self.film.offer(self.steps, lambda: self.picture(view))

    def watched(self) -> None:
        """Explore with a bar, until the end or Ctrl-C."""
        layout = self.env.config.layout  # a shipped name, or a whole layout
        echo(f"exploring {layout if isinstance(layout, str) else layout['name']}")
        with Bar(1.0, *SHARE) as bar, suppress(KeyboardInterrupt):
            self.explore(lambda run: run.show(bar))

    def show(self, bar: Bar) -> None:
        """Show the share of the building that has been seen, and what has been found, in at most 65 characters."""
        metrics = self.view.metrics
        found = FOUND.format(**metrics, error_cm=100.0 * metrics["pose_error_m"], speed=self.steps_per_s)
        bar.show(metrics["coverage"], found, found)

    def keep_data(self, folder: Path) -> dict[str, Any]:
        """Write metrics, configuration and paths into `folder`; returns the metrics."""
        period_s = self.env.config.robot.period_s
        metrics = {"ended": self.ended, **self.env.summary(), "steps_per_s": round(self.steps_per_s, 1)}
        recipe = {"seed": self.seed, "policy": "breadth_first", "config": self.env.config.to_dict()}
        times = [step * period_s for step in range(len(self.estimated))]
        paths = {"trajectory.tum": (times, self.estimated), "truth.tum": (times, self.true)}
        _keep_data(folder, metrics, recipe, paths)
        return metrics

    def keep_pictures(self, folder: Path) -> None:
        """Write the other `FILES` into `folder`."""
        self.film.add(self.picture(self.view))  # the last step, whether its turn has come or not
        _keep_pictures(folder, self.view.slam_output, self.view, self.film)
        curves = curves_figure(self.title, self.env.config.robot.period_s, self.moments)
        with naming(folder / "curves.png"):
            save(curves, folder / "curves.png")
        (folder / "replay.html").unlink(missing_ok=True)  # of an earlier run
        if self.recorder is not None:
            write_page(self.replay(), folder / "replay.html")

    def picture(self, view: SceneView) -> Bytes:
        """A frame of the film, whose size fits the building."""
        self.screen = self.screen or Screen.around(view.bounds, FILM_WIDTH)
        return self.screen.frame(view)

    def replay(self) -> dict[str, Any]:
        """The run as its page plays it."""
        assert self.recorder is not None
        found = ", ".join(f"{name} {value}" for name, value in summary(self.view.metrics))
        return self.recorder.run(self.title, f"{self.ended}: {found}")

    @property
    def title(self) -> str:
        """The building, the estimator and the seed."""
        return f"{self.view.title.partition(', step')[0]}, seed {self.seed}"


class LogFiles:
    """The film and the path of a run in progress, and the files at its end."""

    def __init__(self, log: Log, planned: int, rerun: RerunLog | None = None) -> None:
        self.log, self.rerun = log, rerun
        self.film = Film(every=max(1, planned // FRAMES))
        self.path: list[Array] = []  # (2,) m, map frame
        self.recorder = Recorder()

    def look(self, output: SlamOutput, row: int) -> None:
        """Keep what belongs to one scan, that of record `row` of the log."""
        self.output = output
        self.path.append(output.belief.T_map_robot[:2].copy())
        self.film.offer(len(self.path) - 1, lambda: self._frame(output))
        view = _view(output, np.array(self.path[-1:]), np.empty((0, 2)), self.log.name)
        seconds = float(self.log.t[row] - self.log.t[0])
        self.recorder.look(view, seconds=seconds)
        if self.rerun is not None:
            self.rerun.look(view, seconds=seconds)

    def show(self, bar: Bar) -> None:
        """Show how many scans are mapped, and what has been found."""
        graph = self.output.graph
        found = f"rooms {len(graph.rooms)} doors {len(graph.doors)}"
        bar.show(len(self.path), found, f"scan {len(self.path)}: {found}")

    def _frame(self, output: SlamOutput) -> Any:
        rooms, doors = len(output.graph.rooms), len(output.graph.doors)
        lost = "" if output.localised else ", the pose is searched for"
        caption = f"scan {len(self.path)}: {rooms} rooms, {doors} doors, {len(output.belief.ids)} landmarks{lost}"
        view = _view(output, np.array(self.path), np.empty((0, 2)), self.log.name)
        return thumbnail(view, FILM_SIZE, self.log.name, caption, scan=True)

    def keep(self, folder: Path, run: LogRun, recipe: Mapping[str, Any]) -> dict[str, Any]:
        """Write `LOG_FILES` into `folder`; the metrics."""
        metrics, reference = run.metrics(), _reference(run)
        paths = {"trajectory.tum": (run.t, run.T_map_robot), "trajectory_final.tum": (run.t, run.T_final_robot)}
        (folder / "truth.tum").unlink(missing_ok=True)
        if len(reference):
            known = np.isfinite(reference[:, 0])
            paths["truth.tum"] = run.t[run.scored][known], reference[known]
        _keep_data(folder, metrics, recipe, paths)
        view = _view(run.output, run.T_map_robot[run.scored, :2], reference[:, :2], _caption(self.log.name, metrics))
        self.film.add(self._frame(run.output))
        _keep_pictures(folder, run.output, view, self.film)
        write_page(self.recorder.run(self.log.name, _caption(run.ended, metrics)), folder / "replay.html")
        _keep_final(folder, run, self.log.name, metrics)
        return metrics


def _keep_final(folder: Path, run: LogRun, name: str, metrics: Mapping[str, Any]) -> None:
    """Write landmarks, grid and picture of the smoothed path."""
    run.final_output.export(landmarks=folder / "landmarks_final.csv", grid=folder / "belief_final.yaml")
    errors = {key.removeprefix(FINAL): value for key, value in metrics.items() if key.startswith(FINAL)}
    _keep_map(folder / "map_final.png", final_view(run, _caption(f"{name}, final trajectory", {**metrics, **errors})))


def final_view(run: LogRun, title: str) -> SceneView:
    """The map and both paths after the smoothing."""
    reference = _reference(replace(run, T_map_robot=run.T_final_robot))
    return _view(run.final_output, run.T_final_robot[run.scored, :2], reference[:, :2], title)


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
        ("", "{landmarks} landmarks, {rooms} rooms, {doors} doors"),
        ("", "trajectory error {ate_m:.2f} m"),
        ("", "relations {relations_m:.3f} m, {relations_deg:.2f} deg"),
    )
    return "    ".join([name, *(said for _, said in filled(parts, metrics))])
