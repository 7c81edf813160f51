"""A drive through two rooms and back, and a map of it."""

import pytest

from mecp_env.slam import SlamOutput, SlamPipeline
from tests.slam.drives import Drive, fed, scripted_drive


@pytest.fixture(scope="session")
def drive() -> Drive:
    return scripted_drive()


@pytest.fixture(scope="module")
def mapped(drive: Drive) -> tuple[SlamPipeline, SlamOutput, Drive]:
    """A pipeline at the end of the drive, its last output, and the drive."""
    pipeline = SlamPipeline()
    *_, output = fed(pipeline, drive)
    return pipeline, output, drive
