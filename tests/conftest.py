"""Each process of the tests computes with one thread, unless the environment says otherwise.

Several wait for each other where other tests run beside. Tests of the threads set their number in processes of their
own; the golden hashes are those of the number that NumPy chooses.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Generator

import pytest

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
