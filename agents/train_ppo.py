"""PPO that drives by velocities, without or with memory (an LSTM), in one file.

    python agents/train_ppo.py --steps 1000000
    python agents/train_ppo.py --steps 1000000 --lstm 128 --epochs 2 --out runs/recurrent_ppo.safetensors

`mecp-env train ppo` and `recurrent_ppo` are the same with checkpoints, resumption, and the best policy by validation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import tyro

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.files import write_atomic
from mecp_env.policies.registry import INSTALL

try:
    from sb3_contrib import RecurrentPPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from mecp_env.learning.encoder import ObservationEncoder
    from mecp_env.learning.environments import vectorise
    from mecp_env.learning.exported import weights_of
    from mecp_env.learning.fits import downsampled
    from mecp_env.learning.learned import tensor_bytes
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; {INSTALL}") from None


@dataclass
class Args:
    """Options of this script."""

    steps: int = 2_000_000  # control steps, of all environments together
    environments: int = 16  # environments side by side, in one process per core
    difficulty: str = "medium"  # easy, medium, hard or huge
    max_steps: int = 3000  # control steps per episode, at most
    seed: int = 0  # of network and environments
    learning_rate: float = 3e-4  # it falls linearly to 0
    rollout: int = 128  # steps per environment and update
    batch: int = 512  # steps per gradient step
    epochs: int = 3  # over the steps of an update
    discount: float = 0.995  # per control step
    lstm: int = 0  # size of the memory; 0: none
    validation: int = 8  # buildings of the validation split in the evaluation at the end
    out: Path = Path("runs/ppo.safetensors")  # the weights


def make_env(args: Args, split: str) -> gym.Env[Any, Any]:
    """An environment with velocity commands."""
    where = {"difficulty": args.difficulty, "split": split, "start": "random", "max_steps": args.max_steps}
    env = gym.make("mecp_env/Rooms-v0", **where)
    return downsampled(env, goals=False)


def make_many(args: Args, count: int, split: str) -> VecMonitor:
    """Environments side by side."""
    return VecMonitor(vectorise([partial(make_env, args, split)] * count))


def main(args: Args) -> None:
    """Train, evaluate on the validation split, save the weights."""
    memory = {"lstm_hidden_size": args.lstm} if args.lstm else {}
    algorithm: Any = RecurrentPPO if args.lstm else PPO
    venv = VecNormalize(make_many(args, args.environments, "train"), norm_obs=False, gamma=args.discount)
    model = algorithm(
        "MultiInputLstmPolicy" if args.lstm else "MultiInputPolicy",
        venv,
        learning_rate=lambda left: args.learning_rate * left,
        n_steps=args.rollout,
        batch_size=args.batch,
        n_epochs=args.epochs,
        gamma=args.discount,
        target_kl=0.03,
        policy_kwargs={
            "net_arch": {"pi": [32], "vf": [32]},
            "log_std_init": -0.7,
            "features_extractor_class": ObservationEncoder,
            "features_extractor_kwargs": {"width": 32, "channels": 8, "attention": True},
            **memory,
        },
        seed=args.seed,
        verbose=1,
        device="cpu",
    )
    model.learn(args.steps)
    venv.close()
    validation = make_many(args, min(args.validation, args.environments), "validation")
    mean, deviation = evaluate_policy(model, validation, args.validation)
    validation.close()
    print(f"return on the validation split: {mean:.3f} +- {deviation:.3f}")
    write_atomic(args.out, tensor_bytes(weights_of(model.policy)))


if __name__ == "__main__":
    main(tyro.cli(Args))
