"""Behaviour cloning: a small network imitates the policy of a Minari dataset, and explores new buildings.

    mecp-env record-dataset bfs --episodes 200
    python agents/behaviour_cloning.py mecp_env/rooms-medium/bfs-goal-flat-v0

The dataset needs the observation "flat" and goal actions, the defaults of `mecp-env record-dataset`. Needs PyTorch and
the extra `datasets`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import minari
import numpy as np
import torch
import tyro
from torch import Tensor, nn

FORBIDDEN = -1e9  # score of a goal that does not exist


@dataclass
class Args:
    """Options of this script."""

    dataset: tyro.conf.Positional[str]  # id of the dataset
    epochs: int = 50  # passes over the dataset
    batch: int = 64  # decisions per update
    learning_rate: float = 1e-3  # of Adam
    episodes: int = 10  # of the evaluation, in buildings of the validation split
    seed: int = 0  # of weights and batches


def load(dataset: Any) -> tuple[Tensor, Tensor, Tensor]:
    """Observations (n,columns), masks (n,32) and the rows that the policy selected (n,), of all episodes."""
    episodes = list(dataset.iterate_episodes())
    seen = np.concatenate([episode.observations[:-1] for episode in episodes])
    masks = np.concatenate([episode.infos["action_masks"][:-1] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    return torch.as_tensor(seen), torch.as_tensor(masks), torch.as_tensor(actions)


def make_network(columns: int, goals: int) -> nn.Module:
    """A network from a flat observation to a score per goal."""
    return nn.Sequential(nn.Linear(columns, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh(), nn.Linear(128, goals))


def scores(network: nn.Module, seen: Tensor, masks: Tensor) -> Tensor:
    """(n,32) scores of the goals that exist."""
    return network(seen).masked_fill(~masks, FORBIDDEN)


def clone(data: tuple[Tensor, Tensor, Tensor], args: Args) -> nn.Module:
    """The network that selects what the policy selected."""
    torch.manual_seed(args.seed)
    seen, masks, actions = data
    network = make_network(seen.shape[1], masks.shape[1])
    optimiser = torch.optim.Adam(network.parameters(), args.learning_rate)
    for _ in range(args.epochs):
        for rows in torch.randperm(len(actions)).split(args.batch):
            loss = nn.functional.cross_entropy(scores(network, seen[rows], masks[rows]), actions[rows])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    return network


def agreement(network: nn.Module, data: tuple[Tensor, Tensor, Tensor]) -> float:
    """Share of the decisions in which the network selects the same goal."""
    seen, masks, actions = data
    with torch.no_grad():
        return float((scores(network, seen, masks).argmax(1) == actions).float().mean())


def explore(env: Any, network: nn.Module | None, seed: int) -> dict[str, float]:
    """The metrics of an episode in the building `seed`; without a network, of random goals."""
    rng = np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed, options={"building": seed})
    over = False
    while not over:
        mask = env.get_wrapper_attr("action_masks")()
        if network is None:
            action = rng.choice(np.flatnonzero(mask)) if mask.any() else 0
        else:
            with torch.no_grad():
                action = scores(network, torch.as_tensor(observation)[None], torch.as_tensor(mask)[None]).argmax()
        observation, _, terminated, truncated, _ = env.step(int(action))
        over = terminated or truncated
    summary: dict[str, float] = env.get_wrapper_attr("summary")()
    return summary


def main(args: Args) -> None:
    """Clone the policy; print how often the network agrees, and what it explores beside random goals."""
    dataset = minari.load_dataset(args.dataset)
    data = load(dataset)
    cut = len(data[2]) * 9 // 10
    network = clone(tuple(part[:cut] for part in data), args)
    held_out = tuple(part[cut:] for part in data)
    print(f"{len(data[2])} decisions; same goal in {agreement(network, held_out):.1%} of the last tenth")
    env = dataset.recover_environment(split="validation")
    for name, policy in (("cloned", network), ("random", None)):
        runs = [explore(env, policy, seed) for seed in range(args.episodes)]
        metres, coverage = (float(np.mean([run[key] for run in runs])) for key in ("metres", "coverage"))
        print(f"{name}: coverage {coverage:.1%} after {metres:.0f} m, means of {args.episodes} episodes")
    env.close()


if __name__ == "__main__":
    main(tyro.cli(Args))
