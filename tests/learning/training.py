"""Shared by the tests of training: runs that take seconds."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

from mecp_env.learning import train
from mecp_env.learning.config import TrainConfig

ROOT = Path(__file__).parent.parent.parent
QUICK = {
    "steps": 24,
    "environments": 2,
    "workers": "here",
    "buildings": {"difficulty": ["easy"], "spec": {"rooms": 3, "loops": 0}},
    "env": {"laser": {"preset": "lms200", "sweeps": 1, "beams": 360}, "max_steps": 150},
    "network": {"width": 16, "grid_channels": 4, "lstm": 8},
    "ppo": {"steps": 6, "batch": 6, "epochs": 1},
    "log": {"evaluate_every": 12, "evaluate_buildings": 1, "checkpoint_s": 0.0, "tensorboard": False},
}


def quick(algorithm: str = "maskable_ppo", **fields: object) -> TrainConfig:
    """A configuration of a run that takes seconds."""
    return TrainConfig.build(QUICK | {"algorithm": algorithm} | fields)


def write_config(path: Path, **fields: object) -> Path:
    """Such a configuration as a file."""
    path.write_text(json.dumps(QUICK | {"algorithm": "maskable_ppo"} | fields))
    return path


def run(tmp_path: Path, *words: str, **fields: object) -> tuple[Path, int]:
    """A run in this process; its folder and exit code."""
    config = write_config(tmp_path / "given.json", **fields)
    before = signal.getsignal(signal.SIGINT)
    try:
        code = train.main(["--config", str(config), "--out", str(tmp_path / "run"), *words])
    finally:
        signal.signal(signal.SIGINT, before)
    return tmp_path / "run", code


def start(*words: str) -> subprocess.Popen[str]:
    """`python -m mecp_env.learning.train` with these arguments, in a separate process."""
    return subprocess.Popen(
        [sys.executable, "-m", "mecp_env.learning.train", *words],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
