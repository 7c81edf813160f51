"""The drive on which the estimator is tested, for its rivals."""

from tests.slam.conftest import drive

__all__ = ["drive"]
