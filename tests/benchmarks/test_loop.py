"""The benchmark `loop`: single scans against a finished map, with the prior that was asked for."""

import dataclasses

import numpy as np
import pytest

from benchmarks import loop, rough_pose
from benchmarks.drives import Drive, record_drive


@pytest.fixture(scope="module")
def drive() -> Drive:
    return record_drive("paper", 0, estimator="truth", max_steps=200)


@pytest.fixture(scope="module")
def finished(drive: Drive) -> rough_pose.Finished:
    return rough_pose.finish(drive)


def test_two_passes_are_worth_something_at_a_wide_prior_and_nothing_at_a_sharp_one(
    drive: Drive, finished: rough_pose.Finished
) -> None:
    looks = [rough_pose.look(drive, finished, step) for step in range(20, len(drive.scans), 10)]
    errors = np.random.default_rng(0).normal(size=(len(looks), 3))

    def right(variant: str, sigma: tuple[float, float]) -> int:
        associator = loop.VARIANTS[variant].associator(drive.slam)
        return int(rough_pose.count_scans(finished, associator, looks, sigma, errors)["right"])

    assert right("mecp", (0.05, 0.5)) == right("mecp in one pass", (0.05, 0.5))
    assert right("mecp", (1.5, 15.0)) > right("mecp in one pass", (1.5, 15.0))


def test_a_pair_with_another_landmark_is_wrong(drive: Drive, finished: rough_pose.Finished) -> None:
    seen = rough_pose.look(drive, finished, 100)
    associator = loop.VARIANTS["mecp"].associator(drive.slam)
    sigma, exact = (0.05, 0.5), np.zeros((1, 3))
    counts = rough_pose.count_scans(finished, associator, [seen], sigma, exact)
    assert (counts["right"], counts["wrong"]) == (1, 0)
    assert counts["pairs"] >= rough_pose.RIGHT_PAIRS
    spurious = dataclasses.replace(seen, true=np.full_like(seen.true, -1))
    none = rough_pose.count_scans(finished, associator, [spurious], sigma, exact)
    assert (none["right"], none["possible"], none["wrong"]) == (0, 0, counts["pairs"])
