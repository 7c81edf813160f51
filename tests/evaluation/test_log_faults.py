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


def test_diverged_and_lost_to_its_end(run: LogRun) -> None:
    assert fault_of(run, LogRunConfig()) is None
    assert "--noise.scale" in str(fault_of(replace(run, ended="diverged"), LogRunConfig()))
    for known, unknown, fails in ((50, 10, True), (0, 60, True), (57, 3, False)):
        localised = np.array([True] * known + [False] * unknown)
        assert (fault_of(replace(run, localised=localised), LogRunConfig()) is not None) == fails
    assert fault_of(replace(run, localised=np.arange(60) >= 30), LogRunConfig()) is None  # not to its end


def test_few_scans_but_for_those_left_out_on_request(run: LogRun) -> None:
    few = replace(run, log=replace(run.log, found=601))
    assert "60 of 601" in str(fault_of(few, LogRunConfig()))
    assert fault_of(replace(run, log=replace(run.log, found=600)), LogRunConfig()) is None
    assert fault_of(replace(run, counts={"damaged lines": 541}), LogRunConfig()) is not None
    resting = replace(run, log=replace(run.log, found=1000), counts={"scans at rest, skipped": 940})
    assert "--odometry none" in str(fault_of(resting, LogRunConfig()))
    assert fault_of(resting, LogRunConfig(rest_m=0.5)) is None
