"""Whole runs give the same bits: over versions (golden hashes), over processes and over thread settings."""

import json
import os
import subprocess
import sys

import pytest

from tests.golden import CASES, probe, run_hashes, stored

OVER_PROCESSES = ("paper_map", "two_rooms_1_cm", "paper_to_the_letter", "snapshot")


@pytest.mark.parametrize("case", CASES)
def test_runs_are_the_golden_ones(case):
    hashes = stored().get(probe())
    if hashes is None:
        pytest.skip("no golden hashes for this machine type; `python -m tests.golden --write` adds them")
    assert run_hashes(case) == hashes[case], f"results changed: if meant, `python -m tests.golden {case} --write`"


@pytest.mark.slow
def test_another_process_with_more_blas_threads_gives_the_same_bits():
    command = [sys.executable, "-m", "tests.golden", *OVER_PROCESSES]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(result.stdout) == {probe(): {case: run_hashes(case) for case in OVER_PROCESSES}}
