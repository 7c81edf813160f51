r"""A stock learner of Stable-Baselines3, from nothing to a learning curve, in one file.

    python agents/train_first.py
    mecp-env evaluate runs/first/seed-0/model.zip random_walk nearest --trust --difficulty easy --max-steps 500

The first line trains PPO on `First-v0` for five minutes on two cores, and writes the model, `progress.csv` and
`curve.png` to `runs/first/`. The published curves: that of the README, then those of docs/ladder.md.

    python agents/train_first.py --seeds 0 1 2
    python agents/train_first.py --env mecp_env/Rooms-v0 --difficulty medium --algorithm maskable_ppo --steps 100000 \
      --max-steps 600 --pace 0.9 --seeds 0 1 2 --evaluate-every 20000 --metric coverage_over_steps --out runs/medium
    python agents/train_first.py --env mecp_env/ActiveHalls-v0 --algorithm maskable_ppo --steps 300000 --pace 0.8 \
      --gamma 0.8 --epochs 4 --seeds 0 1 2 --evaluate-every 300000 --metric correct_coverage_over_steps --out runs/halls
"""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import tyro
from matplotlib.figure import Figure

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.episode.tasks import TASKS
from mecp_env.policies.registry import INSTALL
from mecp_env.policies.rollout import EpisodeTask, run_episode
from mecp_env.policies.setting import Setting

try:
    import torch
    from sb3_contrib import MaskablePPO
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    from mecp_env.learning import sb3_batch
except ModuleNotFoundError as error:
    raise SystemExit(f"{error.name} is not installed; {INSTALL}") from None

ALGORITHMS: dict[str, Any] = {"ppo": PPO, "maskable_ppo": MaskablePPO}
METRICS = ("coverage", "coverage_over_steps", "correct_coverage_over_steps")
COLUMNS = ("steps", "minutes", *METRICS)
RATES = {"discrete": 5e-4, "goal": 3e-3}
SETTINGS: dict[str, dict[str, Any]] = {  # a goal takes some 20 control steps: few decisions, used more often
    "discrete": {"n_steps": 256, "batch_size": 256, "gamma": 0.99, "ent_coef": 0.01},
    "goal": {
        "n_steps": 8,
        "batch_size": 64,
        "n_epochs": 12,
        "gamma": 0.9,
        "gae_lambda": 0.9,
        "clip_range": 0.3,
        "policy_kwargs": {"net_arch": [64]},
    },
}
LINES = {
    "nearest": "nearest goal, scripted",
    "next_best_view": "next best view, scripted",
    "random_goal": "random goals",
}


@dataclass
class Args:
    """Options of this script."""

    env: str = "mecp_env/First-v0"
    difficulty: str = ""  # of Rooms-v0
    algorithm: Literal["ppo", "maskable_ppo"] = "ppo"
    actions: Literal["", "discrete", "goal"] = ""  # "": goals with maskable_ppo, else five motions
    minutes: float = 5.0  # of training per seed, evaluations left out; with --steps as long as these take
    steps: int = 0  # control steps per seed; 0: as many as the minutes allow
    seeds: tuple[int, ...] = (0,)
    environments: int = 8
    evaluate_every: int = 50_000  # control steps
    buildings: int = 20  # of the validation split, in an evaluation
    max_steps: int = 0  # of an episode; 0: those of the environment
    pace: float = 0.0  # weight of this term of the reward (docs/rewards.md)
    shaping: float = 0.0  # the same
    gamma: float = 0.0  # discount per decision; 0: that for the actions
    epochs: int = 0  # passes over a batch; 0: those for the actions
    metric: Literal["coverage", "coverage_over_steps", "correct_coverage_over_steps"] = "coverage"  # of the curve
    out: Path = Path("runs/first")

    @property
    def kind(self) -> str:
        """Of actions: "discrete" or "goal"."""
        return self.actions or ("goal" if self.algorithm == "maskable_ppo" else "discrete")

    @property
    def options(self) -> dict[str, Any]:
        """The keywords of `gymnasium.make`."""
        buildings = {"difficulty": self.difficulty} if self.difficulty else {}
        limit = {"max_steps": self.max_steps} if self.max_steps else {}
        weights = {name: weight for name, weight in (("pace", self.pace), ("shaping", self.shaping)) if weight}
        reward = {"reward": weights} if weights else {}
        return {"observation": "flat", "start": "random", "actions": self.kind, **buildings, **limit, **reward}

    @property
    def settings(self) -> dict[str, Any]:
        """Those of the algorithm: these actions' and the given ones."""
        given = {"gamma": self.gamma, "n_epochs": self.epochs}
        return SETTINGS[self.kind] | {name: value for name, value in given.items() if value}


class Curve(BaseCallback):
    """Evaluates now and then, outside of the clock of the training, and ends it when it has taken its time."""

    def __init__(self, args: Args, file: Any) -> None:
        super().__init__()
        self.args, self.file, self.writer = args, file, csv.writer(file)
        self.env = gym.make(args.env, split="validation", **args.options)
        self.begun, self.aside = time.monotonic(), 0.0
        self.steps = self.due = 0

    @property
    def minutes(self) -> float:
        """Trained until now."""
        return (time.monotonic() - self.begun - self.aside) / 60.0

    @property
    def left(self) -> float:
        """Share of the training that is left."""
        done = self.steps / self.args.steps if self.args.steps else self.minutes / self.args.minutes
        return max(0.0, 1.0 - done)

    def _on_training_start(self) -> None:
        self.writer.writerow(COLUMNS)
        self._evaluate()

    def _on_step(self) -> bool:
        self.steps += sum(info.get("periods", 1) for info in self.locals["infos"])  # a goal takes many control steps
        if self.steps >= self.due:
            self._evaluate()
        return self.left > 0.0

    def _on_training_end(self) -> None:
        self._evaluate()

    def _evaluate(self) -> None:
        self.due += self.args.evaluate_every
        start, minutes = time.monotonic(), self.minutes
        scores = np.mean([explore(self.env, self.model, building) for building in range(self.args.buildings)], axis=0)
        self.writer.writerow([self.steps, f"{minutes:.2f}", *(f"{score:.4f}" for score in scores)])
        self.file.flush()
        shown = ", ".join(f"{name} {score:.3f}" for name, score in zip(METRICS, scores, strict=True))
        print(f"{minutes:5.1f} min {self.steps:9,} steps: {shown}", flush=True)
        self.aside += time.monotonic() - start


def explore(env: gym.Env[Any, Any], model: Any, building: int) -> list[float]:
    """The metrics of an episode; actions are drawn as in training."""
    observation, info = env.reset(seed=building, options={"building": building})
    masked = isinstance(model, MaskablePPO)
    over = False
    while not over:
        masks = {"action_masks": env.get_wrapper_attr("action_masks")()} if masked else {}
        action, _ = model.predict(observation, deterministic=False, **masks)
        observation, _, terminated, truncated, info = env.step(int(action))
        over = terminated or truncated
    return [float(info[name]) for name in METRICS]


def train(args: Args, seed: int, folder: Path) -> None:
    """Train a seed; write model and curve. The learning rate falls to 0."""
    folder.mkdir(parents=True, exist_ok=True)
    settings, rate = args.settings, RATES[args.kind]
    venv = VecMonitor(sb3_batch.make(args.env, args.environments, **args.options))
    venv = VecNormalize(venv, norm_obs=False, gamma=settings["gamma"])
    algorithm = MaskablePPO if args.algorithm == "maskable_ppo" else PPO
    with (folder / "progress.csv").open("w", newline="") as file:
        curve = Curve(args, file)
        model = algorithm("MlpPolicy", venv, lambda _: rate * curve.left, seed=seed, device="cpu", **settings)
        model.learn(10**9, callback=curve)
    venv.close()
    model.learning_rate = rate  # a function of this script cannot be loaded elsewhere
    model.lr_schedule = None
    model.save(folder / "model.zip")
    (folder / "model.json").write_text('{"deterministic": false}\n')  # `evaluate` draws actions, as in training


def lines(args: Args) -> dict[str, float]:
    """The metric of scripted policies in the validation buildings."""
    task = args.env.partition("/")[2]
    limit = gym.make(args.env, **args.options).get_wrapper_attr("config").max_steps
    setting = Setting(args.difficulty or "easy", "validation", "slam", limit, task if task in TASKS else "")
    key = {"correct_coverage_over_steps": "correct_over_steps"}.get(args.metric, args.metric)

    def score(policy: str) -> float:
        episodes = [run_episode(EpisodeTask(policy, building, setting)) for building in range(args.buildings)]
        return float(np.mean([episode.figures[key] for episode in episodes]))

    chosen = LINES if args.kind == "goal" else {"nearest": LINES["nearest"], "random_walk": "random walk"}
    return {text: score(policy) for policy, text in chosen.items()}


def draw(args: Args, folders: Sequence[Path], references: Mapping[str, float]) -> None:
    """Write `curve.png`: mean and range of the seeds over the control steps, scripted policies as lines."""
    curves = [np.genfromtxt(folder / "progress.csv", delimiter=",", names=True) for folder in folders]
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    steps = np.linspace(0.0, min(curve["steps"][-1] for curve in curves), 100)
    values = 100.0 * np.array([np.interp(steps, curve["steps"], curve[args.metric]) for curve in curves])
    name, minutes = ALGORITHMS[args.algorithm].__name__, np.mean([curve["minutes"][-1] for curve in curves])
    seeds = f"{len(curves)} seeds" if len(curves) > 1 else "one seed"
    axes.plot(
        steps / 1000.0, values.mean(axis=0), color="#0072b2", label=f"stock {name}, {seeds}, {minutes:.0f} min each"
    )
    axes.fill_between(steps / 1000.0, values.min(axis=0), values.max(axis=0), color="#0072b2", alpha=0.2)
    for (text, value), style in zip(references.items(), ("--", "-.", ":"), strict=False):
        axes.axhline(100.0 * value, color="0.3", linestyle=style, label=text)
    axes.set(xlabel="thousand control steps", ylabel=f"{args.metric.replace('_', ' ')}, %", ylim=(0, 102))
    axes.legend(loc="lower right")
    figure.savefig(args.out / "curve.png", dpi=250)


def main(args: Args) -> None:
    """Train all seeds, and draw their curve."""
    torch.set_num_threads(1)  # the environments need the other core
    folders = [args.out / f"seed-{seed}" for seed in args.seeds]
    for seed, folder in zip(args.seeds, folders, strict=True):
        train(args, seed, folder)
    draw(args, folders, lines(args))
    print(f"curve.png and seed-*/model.zip: {args.out}")


if __name__ == "__main__":
    main(tyro.cli(Args))
