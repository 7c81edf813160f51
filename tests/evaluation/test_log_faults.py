"""Which runs on a log are of no use, with the option to try."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mecp_env.evaluation.log_run import LogRun, LogRunConfig, fault_of, run_log
from mecp_env.logs import read_log
from tests.logs.files import write_archive


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> LogRun:
    return run_log(read_log(write_archive(tmp_path_factory.mktemp("logs") / "a.npz", scans=60)))


def test_a_sound_run(run: LogRun) -> None:
    assert fault_of(run, LogRunConfig()) is None


def test_diverged(run: LogRun) -> None:
    assert "--noise.scale" in str(fault_of(replace(run, ended="diverged"), LogRunConfig()))


@pytest.mark.parametrize(
    ("known", "fails"),
    [
        ([True] * 50 + [False] * 10, True),
        ([False] * 60, True),
        ([True] * 57 + [False] * 3, False),
        ([False] * 30 + [True] * 30, False),
    ],
)
def test_lost_to_its_end(run: LogRun, known: list[bool], fails: bool) -> None:
    assert (fault_of(replace(run, localised=np.array(known)), LogRunConfig()) is not None) == fails


def test_few_scans(run: LogRun) -> None:
    few = replace(run, log=replace(run.log, found=601))
    assert "60 of 601" in str(fault_of(few, LogRunConfig()))
    assert fault_of(replace(run, log=replace(run.log, found=600)), LogRunConfig()) is None
    assert fault_of(replace(run, counts={"damaged lines": 541}), LogRunConfig()) is not None


def test_scans_that_are_left_out_on_request(run: LogRun) -> None:
    resting = replace(run, log=replace(run.log, found=1000), counts={"scans at rest, skipped": 940})
    assert "--odometry none" in str(fault_of(resting, LogRunConfig()))
    assert fault_of(resting, LogRunConfig(rest_m=0.5)) is None
