import multiprocessing
from collections.abc import Iterator
from multiprocessing.forkserver import _forkserver

import pytest

from benchmarks.tables import report_of

pytest.importorskip("stable_baselines3", reason="needs the extra rl")
stock_ppo = pytest.importorskip("benchmarks.stock_ppo")


@pytest.fixture(scope="module", autouse=True)
def imported() -> Iterator[None]:
    """The fork server has imported what all processes of `SubprocVecEnv` import, PyTorch among it."""
    before = _forkserver._preload_modules
    _forkserver._stop()
    multiprocessing.set_forkserver_preload(["mecp_env.vector.preload", "stable_baselines3.common.env_util"])
    yield
    _forkserver._stop()
    multiprocessing.set_forkserver_preload(before)


@pytest.mark.slow
@pytest.mark.parametrize("case", stock_ppo.CASES, ids=lambda case: case.name)
def test_every_case_has_a_speed_and_a_row(case: stock_ppo.Case) -> None:
    figures = stock_ppo.compare(case, 1, 0.05, 64)
    assert all(figures[name]["value"] > 0.0 for name in ("steps_per_s", "over_single", "two_cores_per_s"))
    assert f"| {case.name} |" in report_of({case.name: figures})
