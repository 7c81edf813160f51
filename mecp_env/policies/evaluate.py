"""Policies compared on the same buildings, from the same starts.

Everything is measured in metres and simulated time, so that a run on another machine says the same.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from mecp_env.core.errors import ConfigError
from mecp_env.core.exit_codes import FAILED, INTERRUPTED, complain, ended, say
from mecp_env.core.intervals import Figures
from mecp_env.core.settings import guess
from mecp_env.policies.comparison import Row, compare, rows_of, timing
from mecp_env.policies.curve import BUDGET_M_PER_M2
from mecp_env.policies.episode import Episode, Task
from mecp_env.policies.page import page
from mecp_env.policies.policy import Agent
from mecp_env.policies.pool import Failure, finished
from mecp_env.policies.registry import EXPLORERS, make_agent, policies
from mecp_env.policies.worlds import Setting, rooms

MOST_JOBS, MOST_EPISODES = 256, 1_000_000
BAR = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
EXAMPLES = f"""policies: {", ".join(policies())}, or the folder of a training run

examples:
  python -m mecp_env.policies.evaluate bfs nearest gain --episodes 20 --jobs 2
  python -m mecp_env.policies.evaluate nearest runs/my-training --split validation --no-truth
  python -m mecp_env.policies.evaluate nearest gain --difficulty hard --record --out runs/hard
"""


@dataclass(frozen=True)
class Args:
    """Compare policies: the same buildings, starts and noise for each; tables, curves and, with --record, a film."""

    policies: Annotated[tuple[str, ...], tyro.conf.Positional]  # names, or folders of training runs
    split: str = "test"  # whose buildings: train, validation or test
    difficulty: str = "medium"  # easy, medium, hard or huge
    episodes: int = 100  # buildings, one episode in each
    jobs: int = 1  # processes at the same time
    estimator: Literal["slam", "known", "truth"] = "slam"  # known: true identities; truth: the exact pose
    truth: bool = True  # with the estimator slam or known, each policy once more with the pose known
    record: bool = False  # a film of all policies side by side, in the first building
    reference: str = "nearest"  # the policy to which the others are compared
    trust: bool = False  # load model files of Stable-Baselines3 (.zip), which may run any code
    max_steps: int = 3000  # an episode is cut there (control steps of 0.4 s)
    json: Path | None = None  # also write the result there, and the page beside it
    out: Path = Path("runs/policies")  # folder for results.json, page.md, episodes.csv, curves.png, side_by_side.gif


@dataclass(slots=True, eq=False)
class Evaluation:
    """Episodes as they come in."""

    args: Args
    order: list[tuple[str, str]]  # policy, estimator: the rows
    episodes: list[Episode] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    interrupted: bool = False

    def take(self, result: Episode | Failure) -> None:
        """Keep what came of a task."""
        if isinstance(result, Episode):
            self.episodes.append(result)
        else:
            self.failures.append(result)
            complain("evaluate", f"failed: {result}")

    @property
    def exit_code(self) -> int:
        return INTERRUPTED if self.interrupted else FAILED if self.failures else 0


def main(args: Args) -> int:
    """Evaluate and write all there is. 0; 1 when an episode failed, 2 for wrong input, 130 after Ctrl-C."""
    return ended("evaluate", lambda: attempt(args))  # Ctrl-C: before the first episode, or while it is written


def attempt(args: Args) -> int:
    """As `main`. Raises `MecpError`, and `KeyboardInterrupt` outside the episodes themselves."""
    check(args)
    evaluation = evaluate(args)
    if evaluation.episodes:
        write(evaluation)
    return evaluation.exit_code


def check(args: Args) -> None:
    """Raise `ConfigError` for what cannot be done, before anything is."""
    if not args.policies:
        raise ConfigError(f"policies: none given; there are {', '.join(policies())}, and folders of training runs")
    within("jobs", args.jobs, 1, MOST_JOBS)
    within("max_steps", args.max_steps, 1, 10_000_000)
    check_reference(args)
    for policy in args.policies:
        agent = make_agent(policy, args.trust)
    if args.reference not in args.policies:
        complain("evaluate", f"{args.reference} is not among the policies, so nothing is compared to it")
    within("episodes", args.episodes, 1, MOST_EPISODES)
    check_episodes(args, agent)
    if args.json is not None:
        check_json(args.json)
    check_writable(args.out)


def check_reference(args: Args) -> None:
    """Raise `ConfigError` unless the reference is one of the policies, or an explorer."""
    known = list(dict.fromkeys((*args.policies, *EXPLORERS)))
    if args.reference not in known:
        near = guess(args.reference, known)
        raise ConfigError(f"reference: {args.reference!r:.80}, expected one of {', '.join(known)}{near}")


def check_episodes(args: Args, agent: Agent) -> None:
    """Raise `ConfigError` where there are not so many buildings, or none of that kind."""
    env = rooms(setting_of(args), agent)
    try:
        env.reset(seed=0, options={"building": args.episodes - 1})
    except ConfigError as error:
        raise ConfigError(f"episodes: {args.episodes}, each in a building of {args.split!r}; {error}") from None
    env.close()


def within(name: str, value: int, low: int, high: int) -> None:
    """Raise `ConfigError` unless low <= value <= high."""
    if not low <= value <= high:
        raise ConfigError(f"{name}: {value}, expected {low} to {high}")


def check_writable(folder: Path) -> None:
    """Make the folder. Raises `ConfigError` where that, or a file in it, cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: {folder}: {error.strerror}; choose another place") from None
    if not os.access(folder, os.W_OK):
        raise ConfigError(f"out: {folder}: cannot be written to; choose another place")


def check_json(path: Path) -> None:
    """Raise `ConfigError` where no JSON file can be written; its page gets the same name with `.md`."""
    if path.suffix != ".json" or path.is_dir():
        raise ConfigError(f"json: {path}: expected the name of a file that ends in .json")
    check_writable(path.parent)


def setting_of(args: Args) -> Setting:
    """Where the policies are compared."""
    return Setting(args.difficulty, args.split, args.estimator, args.max_steps)


def tasks_of(args: Args) -> list[Task]:
    """All episodes, building by building: what is done when somebody stops it can be compared."""
    setting = setting_of(args)
    settings = [setting, *([replace(setting, estimator="truth")] if args.truth and args.estimator != "truth" else [])]
    names = list(dict.fromkeys(args.policies))
    return [
        Task(name, number, each, args.trust) for number in range(args.episodes) for each in settings for name in names
    ]


def evaluate(args: Args) -> Evaluation:
    """Play all episodes; after Ctrl-C, what was finished is there."""
    tasks = tasks_of(args)
    evaluation = Evaluation(args, list(dict.fromkeys((task.policy, task.setting.estimator) for task in tasks)))
    console = Console(stderr=True)
    with Progress(*BAR, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("episodes", total=len(tasks))
        collect(evaluation, tasks, lambda: progress.advance(bar))
    return evaluation


def collect(evaluation: Evaluation, tasks: Sequence[Task], advance: Callable[[], None]) -> None:
    """Take in what comes of the tasks until they are done, or somebody presses Ctrl-C."""
    try:
        for done, result in enumerate(finished(tasks, evaluation.args.jobs), start=1):
            evaluation.take(result)
            advance()
            say_in_a_file(done, len(tasks))
    except KeyboardInterrupt:
        evaluation.interrupted = True


def say_in_a_file(done: int, count: int) -> None:
    """A line every tenth of the way where there is no terminal to draw a bar on."""
    if not sys.stderr.isatty() and 10 * done // count > 10 * (done - 1) // count:
        print(f"evaluate: {done} of {count} episodes", file=sys.stderr)


def write(evaluation: Evaluation) -> None:
    """Write figures, page, episodes, curves and, where wanted, the film; print the page."""
    args, rows = evaluation.args, rows_of(evaluation.episodes, evaluation.order)
    if not rows:
        print("evaluate: no building was finished by every policy: nothing to compare", file=sys.stderr)
        return
    result = result_of(evaluation, rows)
    text = page(result)
    write_result(result, text, args.out / "results.json", args.out / "page.md")
    write_episodes(evaluation.episodes, args.out / "episodes.csv")
    if args.json is not None:
        write_result(result, text, args.json, args.json.with_suffix(".md"))
    draw(result, args)
    say(text)
    say(f"written to {args.out}")


def draw(result: Figures, args: Args) -> None:
    """Curves, and the film where it is wanted; matplotlib and pygame are loaded only here."""
    from mecp_env.policies.pictures import draw_curves

    title = f"{result['buildings']} buildings, {args.difficulty}, {args.split} split; bands: 95 % intervals of the mean"
    draw_curves(result["rows"], title, args.out / "curves.png")
    if args.record:
        from mecp_env.policies.film import write_film

        write_film(list(dict.fromkeys(args.policies)), setting_of(args), args.out / "side_by_side.gif", args.trust)


def result_of(evaluation: Evaluation, rows: Sequence[Row]) -> Figures:
    """All that is written as JSON. But for the date, the command and `timing`, the same evaluation says the same."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "command": " ".join(["python -m mecp_env.policies.evaluate", *sys.argv[1:]]),
        "system": f"{platform.system()} {platform.machine()}, python {platform.python_version()}",
        "setting": asdict(setting_of(evaluation.args)),
        "budget_m_per_m2": BUDGET_M_PER_M2,
        "reference": evaluation.args.reference,
        "buildings": len(rows[0].episodes),
        "interrupted": evaluation.interrupted,
        "failures": sorted(str(failure) for failure in evaluation.failures),
        "rows": compare(rows, evaluation.args.reference),
        "timing": timing(rows),
    }


def write_result(result: Figures, text: str, json_path: Path, page_path: Path) -> None:
    """Write the result as JSON, and its page."""
    json_path.write_text(json.dumps(result, indent=1) + "\n")
    page_path.write_text(text)


def write_episodes(episodes: Sequence[Episode], path: Path) -> None:
    """Write a line an episode, in the order of policy, estimator and building."""
    ordered = sorted(episodes, key=lambda e: (e.task.policy, e.task.setting.estimator, e.task.building))
    with path.open("w", newline="") as file:
        lines = csv.writer(file)
        lines.writerow(["policy", "estimator", "building", *ordered[0].figures])
        for episode in ordered:
            task = episode.task
            lines.writerow([task.policy, task.setting.estimator, task.building, *episode.figures.values()])


if __name__ == "__main__":
    sys.exit(
        main(tyro.cli(Args, prog="python -m mecp_env.policies.evaluate", description=f"{Args.__doc__}\n\n{EXAMPLES}"))
    )
