"""The checks of `mecp-env doctor` that look at the machine: nothing here makes an environment."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement

from mecp_env.cli.findings import Finding

EXTRAS = ("torch", "stable-baselines3", "sb3-contrib")
LEAST_PYTHON = (3, 11)
ROOT = Path(__file__).parents[2]
OPEN_WINDOW = "from mecp_env.render.window import require_display; print(require_display())"
DISPLAY_TIMEOUT_S = 60.0


def python() -> Iterator[Finding]:
    """The version of Python, and where it runs."""
    said = f"{platform.python_version()} on {platform.system()} {platform.machine()}, {sys.executable}"
    old = sys.version_info[:2] < LEAST_PYTHON
    yield Finding("FAIL", "Python", said, "use Python 3.11 or newer") if old else Finding("PASS", "Python", said)


def dependencies() -> Iterator[Finding]:
    """Each distribution that must be there, with its version and the one that is needed."""
    for text in required():
        needed = Requirement(text)
        if needed.marker is None or needed.marker.evaluate({"extra": ""}):
            yield dependency(needed)


def required() -> list[str]:
    """What the package says that it needs: installed, or in the folder that it runs from."""
    try:
        return metadata.requires("mecp_env") or []
    except metadata.PackageNotFoundError:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        return list(project["dependencies"])


def dependency(needed: Requirement) -> Finding:
    """Whether one distribution is there in a version that will do."""
    install = f'pip install "{needed.name}{needed.specifier}"'
    try:
        version = metadata.version(needed.name)
    except metadata.PackageNotFoundError:
        return Finding("FAIL", needed.name, f"missing (needs {needed.specifier})", install)
    if not needed.specifier.contains(version, prereleases=True):
        return Finding("FAIL", needed.name, f"{version} (needs {needed.specifier})", install)
    return Finding("PASS", needed.name, f"{version} (needs {needed.specifier})")


def extras() -> Iterator[Finding]:
    """What only learning needs."""
    found = []
    for name in EXTRAS:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} not installed")
    yield Finding("PASS", "for learning", f"{', '.join(found)} (optional)")


def processor() -> Iterator[Finding]:
    """Cores, and how numba would use them."""
    import numba

    cores = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else cores
    yield Finding("PASS", "processor", f"{cores} cores, {usable} of them for this process")
    threads = f"up to {numba.config.NUMBA_NUM_THREADS} threads, layer {numba.config.THREADING_LAYER!r}"
    yield Finding("PASS", "numba threading", f"{threads}; an environment itself runs on one core, without threads")


def compiled_functions() -> Iterator[Finding]:
    """Where compiled functions are kept, whether that can be written, and what it holds."""
    import numba

    from mecp_env.core.jit import CHECKED_CACHE

    if numba.config.DISABLE_JIT:
        yield Finding(
            "WARN", "compiled functions", "NUMBA_DISABLE_JIT is set: everything is slow", "unset NUMBA_DISABLE_JIT"
        )
    if not CHECKED_CACHE:
        said = f"numba {numba.__version__} keeps its cache elsewhere: every edit of the package compiles everything"
        yield Finding("WARN", "compiled functions", said, 'pip install "numba==0.68.*"')
        return
    from mecp_env.core.jit_cache import cache_directory

    yield from cache(cache_directory())


def cache(place: Path) -> Iterator[Finding]:
    """Whether the cache can be written, and whether it is warm."""
    from mecp_env.core.warm_up import missing_entries

    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=place).close()
    except OSError as error:
        fix = "set NUMBA_CACHE_DIR to a folder of yours that can be written"
        yield Finding(
            "WARN", "function cache", f"{place}: {error.strerror}; functions are compiled in every process", fix
        )
        return
    sizes = [entry.stat().st_size for entry in place.glob("*.nbc")]
    yield Finding(
        "PASS", "function cache", f"{place}, {len(sizes)} functions, {sum(sizes) / 1e6:.0f} MB, can be written"
    )
    if missing_entries():
        cold = "cold: the self-test compiles first, on all cores; about a minute, once"
        yield Finding("WARN", "function cache", cold, "mecp-env warmup")


def display() -> Iterator[Finding]:
    """Whether a window can be opened; tested in a separate process, which SDL may end or fill with messages."""
    line = [sys.executable, "-c", OPEN_WINDOW]
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        line, capture_output=True, text=True, timeout=DISPLAY_TIMEOUT_S, env=os.environ | {"PYTHONPATH": path}
    )
    if done.returncode == 0:
        yield Finding("PASS", "display", f"windows can be opened (SDL driver {done.stdout.strip()})")
        return
    why = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    said = "no window can be opened; pictures, films and training need none"
    yield Finding("WARN", "display", said, f"for `play` and `--render human`: {why.partition('; ')[2] or why}")
