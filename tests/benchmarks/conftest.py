"""A drive and its map that several tests look at."""

import pytest

from benchmarks import rough_pose
from benchmarks.drives import Drive, record_drive


@pytest.fixture(scope="session")
def drive() -> Drive:
    """An exploration of 200 steps with the true pose as the driver."""
    return record_drive("paper", 0, estimator="truth", max_steps=200)


@pytest.fixture(scope="session")
def finished(drive: Drive) -> rough_pose.Finished:
    return rough_pose.finish(drive)
