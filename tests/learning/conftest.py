"""Tests of training need the extra `rl`, but for those of its configuration."""

from importlib.util import find_spec
from pathlib import Path

FILES = {path.name for path in Path(__file__).parent.glob("test_*.py")}
collect_ignore = [] if find_spec("sb3_contrib") else sorted(FILES - {"test_training_config.py"})
