"""PPO with memory (LSTM) that drives by velocities: `train_ppo.py` with another algorithm.

    python agents/train_recurrent_ppo.py --steps 1000000

`mecp-env train recurrent_ppo` is the same with checkpoints, resumption, and the best policy by validation.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import train_ppo  # the script beside this one
import tyro

try:
    from sb3_contrib import RecurrentPPO
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; {train_ppo.INSTALL}") from None


@dataclass
class Args(train_ppo.Args):
    """Options of this script."""

    epochs: int = 2  # over the steps of an update
    lstm: int = 128  # size of the memory
    out: Path = Path("runs/recurrent_ppo.safetensors")  # the weights


if __name__ == "__main__":
    options = tyro.cli(Args)
    train_ppo.main(options, RecurrentPPO, "MultiInputLstmPolicy", lstm_hidden_size=options.lstm)
