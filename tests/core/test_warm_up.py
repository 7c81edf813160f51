"""Compiling ahead: the list of compiled functions, types as plain data, helpers only where wanted."""

from __future__ import annotations

import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numba import typeof, types

from mecp_env.core import warm_up
from mecp_env.core.jit import compiled
from mecp_env.slam.mecp.edge_labels import Edge

FROZEN = np.zeros(3)
FROZEN.setflags(write=False)


@compiled
def twice(x: float) -> float:
    return 2.0 * x


@pytest.mark.parametrize(
    "value",
    [1.5, 3, True, np.zeros((2, 3)), np.zeros(4, np.int16), np.zeros((2, 2), bool), FROZEN, (1, 2.0), (1.0, 2.0)],
)
def test_types_survive_as_plain_data(value: object) -> None:
    kind = typeof(value)
    assert warm_up.decode(json.loads(json.dumps(warm_up.encode(kind)))) == kind


def test_named_tuples_survive_too() -> None:
    kind = types.NamedTuple([types.float64] * len(Edge._fields), Edge)
    assert warm_up.decode(json.loads(json.dumps(warm_up.encode(kind)))) == kind


def test_other_kinds_are_refused() -> None:
    with pytest.raises(ValueError, match="no kernel takes"):
        warm_up.encode(typeof("text"))


def test_the_list_names_kernels_that_exist() -> None:
    entries = json.loads(warm_up.LIST.read_text())
    assert len(entries) > 50
    gone = []
    for module, name, arguments in entries:
        try:
            assert hasattr(getattr(__import__(module, fromlist=[name]), name), "py_func")
            [warm_up.decode(argument) for argument in arguments]
        except (ImportError, AttributeError):
            gone.append(f"{module}.{name}")
    assert not gone, "update the list: python -m mecp_env.cli.record_signatures"


def test_a_share_compiles_what_it_can_and_skips_the_rest() -> None:
    entries = [["no.such.module", "f", []], [__name__, "twice", ["float64"]], [__name__, "gone", []]]
    warm_up.compile_share(entries, 0, 1)
    assert (types.float64,) in twice.signatures  # type: ignore[attr-defined]


def test_helpers_are_one_a_further_core_and_can_be_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2}, raising=False)
    monkeypatch.delenv(warm_up.SWITCH, raising=False)
    assert warm_up.helpers_wanted() == 2
    monkeypatch.setenv(warm_up.SWITCH, "1")
    assert warm_up.helpers_wanted() == 1
    monkeypatch.setenv(warm_up.SWITCH, "none")
    assert warm_up.helpers_wanted() == 0


def test_a_worker_of_a_pool_starts_no_helpers() -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(warm_up.helpers_wanted) == 0


def test_only_one_process_at_a_time_starts_helpers(tmp_path: Path) -> None:
    lock = tmp_path / "helpers.lock"
    assert warm_up._take(lock)
    assert not warm_up._take(lock)
    long_ago = time.time() - 2 * warm_up.STALE_S
    os.utime(lock, (long_ago, long_ago))
    assert warm_up._take(lock)
    assert not warm_up._take(tmp_path / "no folder" / "helpers.lock")


def test_a_cold_start_gets_help_and_leaves_nothing_behind(tmp_path: Path) -> None:
    code = (
        "import os, time; os.sched_getaffinity = lambda pid: {0, 1}; import numpy as np; from mecp_env import warm_up\n"
        "from mecp_env.core.linalg import mahalanobis; mahalanobis(np.ones(2), np.eye(2))\n"
        f"end = time.time() + 60; folder = {str(tmp_path)!r}; from pathlib import Path\n"
        "while time.time() < end and len(list(Path(folder).rglob('*.nbc'))) < 6: time.sleep(0.2)\n"
        "print(len(list(Path(folder).rglob('*.nbc'))))"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), warm_up.SWITCH: "1"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) >= 6  # one by the process itself
    assert not list(tmp_path.rglob("*.lock"))
