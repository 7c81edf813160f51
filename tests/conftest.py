"""Each process of the tests computes with one thread, unless the environment says otherwise.

Several wait for each other where other tests run beside. Tests of the threads set their number in processes of their
own; the golden hashes are those of the number that NumPy chooses.
"""

import gc
import importlib.util
import os
import sys
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest

from tests.launcher import Launcher

LOADED = ("mecp_env.cli.main", "mecp_env.policies", "mecp_env.vector.preload")
LEARNING = ("mecp_env.learning.train", "stable_baselines3.common.evaluation", "torch._dynamo")

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # read when NumPy and PyTorch are imported, by no plugin
    os.environ.setdefault(name, "1")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is imported with the tests stays: no search for garbage looks at it again, nor copies it into a fork."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.fixture(scope="session")
def launcher() -> Iterator[Launcher]:
    """Of processes that have loaded the functions of the package, and imported what trains, where it is installed."""
    learning = LEARNING if importlib.util.find_spec("sb3_contrib") else ()
    with Launcher(*LOADED, *learning, path=Path(__file__).parent.parent) as launcher:
        yield launcher


@pytest.fixture
def own_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working directory; what modules in it register is forgotten in the end."""
    from mecp_env.config import REWARDS
    from mecp_env.core import provenance
    from mecp_env.core.settings import load_parts
    from mecp_env.episode import buildings
    from mecp_env.policies.registry import EXPLORERS
    from mecp_env.slam import association, config, filters, mecp

    load_parts()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(provenance, "_imported", {})
    for names in (config.METHODS, config.KINDS, config.STRUCTURE_NAMES, REWARDS, buildings.NAMES):
        monkeypatch.setattr(names, "others", [*names.others])
    makers = association.ASSOCIATORS, filters.FILTERS, mecp.STRUCTURES, EXPLORERS, buildings.SOURCES
    before = [set(table) for table in makers]
    yield tmp_path
    for table, known in zip(makers, before, strict=True):
        for name in set(table) - known:
            del table[name]
    for file in tmp_path.glob("*.py"):
        sys.modules.pop(file.stem, None)
