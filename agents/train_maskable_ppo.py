"""MaskablePPO that selects goals, in one file: environments, network, option discounts, training, evaluation.

    python agents/train_maskable_ppo.py --steps 20000 --environments 8

`mecp-env train maskable_ppo` is the same with checkpoints, resumption, and the best policy by validation.
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
    from sb3_contrib import MaskablePPO
    from sb3_contrib.common.maskable.evaluation import evaluate_policy
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from mecp_env.learning.encoder import GoalPointerPolicy, ObservationEncoder
    from mecp_env.learning.environments import OptionReward, vectorise
    from mecp_env.learning.exported import weights_of
    from mecp_env.learning.fits import downsampled
    from mecp_env.learning.learned import tensor_bytes
    from mecp_env.learning.sb3_batch import OptionBuffer, OptionCallback
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; {INSTALL}") from None


@dataclass
class Args:
    """Options of this script."""

    steps: int = 100_000  # decisions (options), of all environments together
    environments: int = 16  # environments side by side, in one process per core
    difficulty: str = "medium"  # easy, medium, hard or huge
    max_steps: int = 3000  # control steps per episode, at most
    seed: int = 0  # of network and environments
    learning_rate: float = 1.5e-3  # it falls linearly to 0
    rollout: int = 32  # decisions per environment and update
    batch: int = 128  # decisions per gradient step
    discount_m: float = 60.0  # a reward that many metres later counts 1/e
    prior: str = "gain"  # the explorer that the untrained network imitates: gain, nearest or none
    width: int = 64  # of the network
    validation: int = 20  # buildings of the validation split in the evaluation at the end
    out: Path = Path("runs/maskable_ppo.safetensors")  # the weights


def make_env(args: Args, split: str) -> gym.Env[Any, Any]:
    """An environment whose actions are options: one step is the drive to a goal, its reward discounted by metres."""
    where = {"difficulty": args.difficulty, "split": split, "start": "random", "max_steps": args.max_steps}
    env = gym.make("mecp_env/Rooms-v0", **where, actions="goal")
    return downsampled(OptionReward(env, discount=1.0, discount_m=args.discount_m), goals=True)


def make_many(args: Args, count: int, split: str) -> VecMonitor:
    """Environments side by side."""
    return VecMonitor(vectorise([partial(make_env, args, split)] * count))


def main(args: Args) -> None:
    """Train, evaluate on the validation split, save the weights."""
    venv = VecNormalize(make_many(args, args.environments, "train"), norm_obs=False, gamma=0.93)
    encoder = {"width": args.width, "channels": 16, "attention": True, "prior": args.prior}
    model = MaskablePPO(
        GoalPointerPolicy,
        venv,
        learning_rate=lambda left: args.learning_rate * left,
        n_steps=args.rollout,
        batch_size=args.batch,
        gamma=1.0,  # the discount follows from the metres of each option
        ent_coef=0.0,
        target_kl=0.03,
        rollout_buffer_class=OptionBuffer,
        policy_kwargs={
            "width": args.width,
            "sharpness": 5.0,
            "features_extractor_class": ObservationEncoder,
            "features_extractor_kwargs": encoder,
        },
        seed=args.seed,
        verbose=1,
        device="cpu",
    )
    model.learn(args.steps, callback=OptionCallback())
    venv.close()
    validation = make_many(args, min(args.validation, args.environments), "validation")
    mean, deviation = evaluate_policy(model, validation, args.validation)
    validation.close()
    print(f"discounted return on the validation split: {mean:.3f} +- {deviation:.3f}")
    write_atomic(args.out, tensor_bytes(weights_of(model.policy)))


if __name__ == "__main__":
    main(tyro.cli(Args))
