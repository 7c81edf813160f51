"""Shared by the tests of training: runs that take seconds."""

import json
import os
from pathlib import Path
from typing import Any

from mecp_env.cli import main as cli
from mecp_env.cli.base import Line, run_command
from mecp_env.cli.train import Train
from mecp_env.learning.config import TrainConfig
from tests.launcher import Launcher, Process

ROOT = Path(__file__).parent.parent.parent
QUICK = {
    "steps": 24,
    "environments": 2,
    "workers": "here",
    "buildings": {"difficulty": ["easy"], "spec": {"rooms": 3, "loops": 0}},
    "env": {"laser": {"sweeps": 1, "range_sigma_m": 0.01, "bearing_sigma_deg": 0.0, "beams": 360}, "max_steps": 150},
    "network": {"width": 16, "grid_channels": 4, "lstm": 8},
    "ppo": {"steps": 6, "batch": 6, "epochs": 1},
    "log": {"evaluate_every": 12, "evaluate_buildings": 1, "checkpoint_s": 0.0, "tensorboard": False},
}


def quick(algorithm: str = "maskable_ppo", **fields: object) -> TrainConfig:
    """A configuration of a run that takes seconds."""
    return TrainConfig.build(QUICK | {"algorithm": algorithm} | fields)


def batch(observation: dict[str, Any], goals: bool = True) -> dict[str, Any]:
    """An observation of the environment as the network takes it."""
    import torch

    from mecp_env.learning.fits import downsample

    return {name: torch.as_tensor(values[None]) for name, values in downsample(observation, goals).items()}


def logits(network: Any, observation: dict[str, Any]) -> Any:
    """The scores of all rows."""
    import torch

    with torch.no_grad():
        return network.get_distribution(batch(observation)).distribution.logits[0]


def shaken(config: TrainConfig) -> Any:
    """A policy in which every input has an influence."""
    import torch

    from mecp_env.learning.encoder import make_network

    torch.manual_seed(0)
    policy = make_network(config)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return policy


def write_config(path: Path, **fields: object) -> Path:
    """Such a configuration as a file."""
    path.write_text(json.dumps(QUICK | {"algorithm": "maskable_ppo"} | fields))
    return path


def made_in(folder: Path) -> list[int]:
    """The decisions at the checkpoints of a run."""
    return sorted(int(path.stem) for path in folder.glob("checkpoints/*.zip") if path.stem.isdecimal())


def weights_in(folder: Path) -> dict[str, Any]:
    """The weights of the policy in the last checkpoint of a run."""
    from stable_baselines3.common.save_util import load_from_zip_file

    return dict(load_from_zip_file(max(folder.glob("checkpoints/*.zip")), load_data=False)[1]["policy"])


def flipped(path: Path) -> None:
    """Turn a bit in the middle of a file."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def run(tmp_path: Path, *words: str, **fields: object) -> tuple[Path, int]:
    """A run in this process; its folder and exit code."""
    config, folder = write_config(tmp_path / "given.json", **fields), tmp_path / "run"
    line = ["--config", str(config), "--out", str(folder), *words]
    return folder, _command(Train(config=config, out=folder), line, words)


def resume(folder: Path, *words: str) -> int:
    """The exit code of a run that continues in this process."""
    return _command(Train(resume=folder), ["--resume", str(folder), *words], words)


def _command(train: Train, line: list[str], words: tuple[str, ...]) -> int:
    """The exit code of `mecp-env train`; a line without `words` is not parsed, which takes a third of a second."""
    return cli.main(["train", *line]) if words else run_command(lambda: train.run(Line(line)))


def start(launcher: Launcher, *words: str) -> Process:
    """`mecp-env train` with these arguments, in a separate process."""
    code = "import runpy; runpy.run_module('mecp_env', run_name='__main__')"
    env = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    return launcher.start(code, "train", *words, cwd=ROOT, env=env)
