"""`mecp-env doctor`: is everything there that the environment needs, and does it work?

`mecp-env completion`: the completion of commands and options in a shell.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import gymnasium
import numpy as np
import tyro
from packaging.requirements import Requirement
from pydantic import Field
from rich.console import Console
from rich.text import Text

from mecp_env.cli.base import FAILED, Command, Line
from mecp_env.core.processes import cores

COLOURS = {"PASS": "green", "WARN": "yellow", "FAIL": "bold red"}
EXTRAS = ("torch", "stable-baselines3", "sb3-contrib")
ROOT = Path(__file__).parents[2]
OPEN_WINDOW = "from mecp_env.render.window import require_display; print(require_display())"
DISPLAY_TIMEOUT_S = 60.0
LEAST_STEPS = 5
FAR_M = 0.5  # an estimate so far from ground truth after two seconds has failed
SLOW_STEPS_S = 50.0
REPORT = "report this, with the lines above"

Env = gymnasium.Env[Any, Any]
Shell = Literal["bash", "zsh", "fish"]
GROUP = "buildings as files, pictures and figures"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: the verdict, on what, what was found, and what to do about it."""

    verdict: Literal["PASS", "WARN", "FAIL"]
    name: str
    said: str
    fix: str = ""


@dataclass(frozen=True)
class Doctor(Command):
    """Check Python, dependencies, processor, function cache and display, then drive for two seconds. Each line starts
    with PASS, WARN or FAIL, and the line below it names a fix. Exit code 1 if a check failed, else 0.

    Examples:
        mecp-env doctor
        mecp-env doctor --seconds 10
    """

    seconds: Annotated[float, Field(ge=0.1, le=600.0)] = 2.0  # how long the self-test drives

    def run(self, line: Line) -> int:
        """Print the finding of each check as soon as it is known."""
        counts = dict.fromkeys(COLOURS, 0)
        for finding in examine(CHECKS, self.seconds):
            echo(finding)
            counts[finding.verdict] += 1
        print(", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
        return FAILED if counts["FAIL"] else 0


def examine(checks: Sequence[Callable[[float], Iterator[Finding]]], seconds: float) -> Iterator[Finding]:
    """What all checks find; one that breaks off is a failure, not the end."""
    for check in checks:
        try:
            yield from check(seconds)
        except Exception as error:  # whatever is wrong with the machine is to be said
            name = check.__name__.replace("_", " ")
            yield Finding("FAIL", name, f"{type(error).__name__}: {error}", "install mecp_env again, or report this")


def echo(finding: Finding) -> None:
    """Print a finding, and below it what to do."""
    console = Console()
    verdict = Text(f"{finding.verdict}  ", COLOURS[finding.verdict])
    console.print(Text.assemble(verdict, f"{finding.name:<16}  {finding.said}"), soft_wrap=True)
    if finding.fix:
        console.print(Text(f"      {'':<16}  -> {finding.fix}"), soft_wrap=True)


def machine(_: float) -> Iterator[Finding]:
    """Python and the cores."""
    where = f"{platform.system()} {platform.machine()}, {sys.executable}"
    yield Finding("PASS", "Python", f"{platform.python_version()} on {where}")
    said = f"{os.cpu_count()} cores, {cores()} of them for this process; an environment runs on one of them"
    yield Finding("PASS", "processor", said)


def dependencies(_: float) -> Iterator[Finding]:
    """Each distribution that must be there, with its version and the one that is needed; then what learning needs."""
    for needed in map(Requirement, metadata.requires("mecp_env") or []):
        if needed.marker is None or needed.marker.evaluate({"extra": ""}):
            yield dependency(needed)
    found = [f"{name} {installed(name) or 'not installed'}" for name in EXTRAS]
    yield Finding("PASS", "for learning", f"{', '.join(found)} (optional)")


def dependency(needed: Requirement) -> Finding:
    """Whether one distribution is there in a version that will do."""
    version = installed(needed.name)
    said = f"{version or 'missing'} (needs {needed.specifier})"
    if version and needed.specifier.contains(version, prereleases=True):
        return Finding("PASS", needed.name, said)
    return Finding("FAIL", needed.name, said, f'pip install "{needed.name}{needed.specifier}"')


def installed(name: str) -> str:
    """The version of a distribution; empty where it is missing."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def compiled_functions(_: float) -> Iterator[Finding]:
    """Whether functions are compiled, where they are kept, whether that can be written, and whether it is warm."""
    import numba

    from mecp_env.core.jit import cache_directory, usable
    from mecp_env.core.warm_up import is_cold, sizes_in

    if numba.config.DISABLE_JIT:
        said = "NUMBA_DISABLE_JIT is set: everything is slow"
        yield Finding("WARN", "compiled functions", said, "unset NUMBA_DISABLE_JIT")
    name, place = "function cache", cache_directory()
    if not usable(place):
        said = f"{place} is not yours alone to write to; functions are compiled in every process"
        yield Finding("WARN", name, said, "set NUMBA_CACHE_DIR to a folder of yours that can be written")
        return
    sizes = sizes_in(place)
    yield Finding("PASS", name, f"{place}, {len(sizes)} functions, {sum(sizes) / 1e6:.0f} MB, can be written")
    if is_cold():
        yield Finding("WARN", name, "cold: the self-test compiles first; a minute or two, once", "mecp-env warmup")


def display(_: float) -> Iterator[Finding]:
    """Whether a window can be opened; tested in a separate process, which SDL may end or fill with messages."""
    line = [sys.executable, "-c", OPEN_WINDOW]
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(line, capture_output=True, text=True, timeout=DISPLAY_TIMEOUT_S, env=env)
    if done.returncode == 0:
        yield Finding("PASS", "display", f"windows can be opened (SDL driver {done.stdout.strip()})")
        return
    why = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    said = "no window can be opened; pictures, films and training need none"
    yield Finding("WARN", "display", said, f"for `play` and `--render human`: {why.partition('; ')[2] or why}")


def self_test(seconds: float) -> Iterator[Finding]:
    """Make `PaperMap-v0`, reset it twice with the same seed, and drive at random for so many seconds."""
    begun = time.perf_counter()
    env = gymnasium.make("mecp_env/PaperMap-v0")
    first = start(env)
    spent = time.perf_counter() - begun
    yield Finding("PASS", "self-test: make", f"PaperMap-v0 made, reset and stepped in {spent:.1f} s")
    yield same_again(first, start(env))
    yield drive(env, seconds)
    env.close()


def start(env: Env) -> dict[str, np.ndarray[Any, Any]]:
    """The observation after a reset with seed 0 and one step."""
    env.reset(seed=0)
    observation: dict[str, np.ndarray[Any, Any]] = env.step(np.array([1.0, 0.0], np.float32))[0]
    return observation


def same_again(first: dict[str, Any], second: dict[str, Any]) -> Finding:
    """Whether the same seed gave the same bits."""
    differing = [name for name in first if not np.array_equal(first[name], second[name])]
    if differing:
        return Finding("FAIL", "self-test: seed", f"the same seed gave another {', '.join(differing)}", REPORT)
    return Finding("PASS", "self-test: seed", "the same seed gave the same observation")


def drive(env: Env, seconds: float) -> Finding:
    """Random actions for so many seconds: observations as declared, an estimate near the truth, a fair speed."""
    env.action_space.seed(0)
    steps, inside, over, begun = 0, True, True, time.perf_counter()
    while inside and (steps < LEAST_STEPS or time.perf_counter() - begun < seconds):
        if over:
            env.reset(seed=steps)
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        steps, over = steps + 1, terminated or truncated
        inside = env.observation_space.contains(observation)
    return judge(steps, steps / (time.perf_counter() - begun), info["pose_error_m"], inside)


def judge(steps: int, speed: float, error_m: float, inside: bool = True) -> Finding:
    """What a drive says of the machine."""
    said = f"{steps} steps, {speed:.0f} per second, the estimate {100.0 * error_m:.1f} cm from ground truth"
    if error_m > FAR_M or not inside:
        return Finding("FAIL", "self-test: drive", said + ("" if inside else "; out of the observation space"), REPORT)
    slow = speed < SLOW_STEPS_S
    fix = "slow: is the machine busy, or NUMBA_DISABLE_JIT set?" if slow else ""
    return Finding("WARN" if slow else "PASS", "self-test: drive", said, fix)


CHECKS = (machine, dependencies, compiled_functions, display, self_test)


@dataclass(frozen=True)
class Completion(Command):
    """Print a script that completes commands and options of mecp-env in bash, zsh or fish.

    Examples:
        mecp-env completion bash > ~/.local/share/bash-completion/completions/mecp-env
        mecp-env completion zsh > ~/.zfunc/_mecp-env
        mecp-env completion fish > ~/.config/fish/completions/mecp-env.fish
    """

    shell: tyro.conf.Positional[Shell]

    def run(self, line: Line) -> int:
        """Let the parser of all commands write the script; it is not run."""
        try:
            tyro.cli(all_commands(), prog="mecp-env", args=["--tyro-write-completion", self.shell, "-"])
        except SystemExit as end:
            return int(end.code or 0)
        raise AssertionError("the parser ends the process after the script")


def all_commands() -> Any:
    """One type of all commands, `worlds list` and its like as commands of a command."""
    from mecp_env.cli.main import COMMANDS, load

    groups = dict[str, list[Any]]()
    for words, (_, _, about) in COMMANDS.items():
        group, _, name = words.rpartition(" ")
        groups.setdefault(group, []).append(_named(load(words), name, about))
    kinds = groups.pop("") + [_named(Union[tuple(inner)], name, GROUP) for name, inner in groups.items()]  # noqa: UP007
    return Union[tuple(kinds)]  # noqa: UP007


def _named(kind: Any, name: str, about: str) -> Any:
    return Annotated[kind, tyro.conf.subcommand(name=name, description=about)]
