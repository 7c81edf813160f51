"""One episode of a policy, drive by drive, on the terminal: what `python -m mecp_env.policies.NAME` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium as gym
import tyro

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.core.errors import ConfigError
from mecp_env.core.exit_codes import ended
from mecp_env.policies.policy import KIND, KINDS, PATH, ROOM, Agent
from mecp_env.policies.registry import make_agent
from mecp_env.policies.worlds import Env, Info, admit, below, masks


@dataclass(frozen=True)
class Args:
    """Explore one building and say how that went."""

    layout: str = "paper"  # a shipped layout, the path of a layout file, or DIFFICULTY:SPLIT:NUMBER (medium:test:3)
    seed: int = 0  # of start, noise and policy
    steps: int = 3000  # control steps of 0.4 s, at most
    estimator: Literal["slam", "known", "truth"] = "slam"  # known: true identities; truth: the exact pose
    start: Literal["layout", "random"] = "layout"  # random: anywhere in free space


def main(policy: str, args: Args | None = None, line: Sequence[str] | None = None) -> int:
    """Explore as the command line says. Exit code 0, 2 for wrong input, or 130 after Ctrl-C."""
    chosen = args if args is not None else tyro.cli(Args, prog=f"python -m mecp_env.policies.{policy}", args=line)
    return ended(policy, lambda: explore(make_agent(policy), chosen))


def explore(agent: Agent, args: Args) -> int:
    """One episode; prints a line a drive, and the figures at the end. Exit code 0; raises `MecpError`."""
    if args.seed < 0:
        raise ConfigError(f"seed: {args.seed}, at least 0")
    env = admit(building(agent, args), agent, lambda observation, info: None)
    observation, info = env.reset(seed=args.seed, options=chosen_building(args.layout))
    agent.reset(args.seed)
    over = False
    while not over:
        action = agent.act(observation, masks(env))
        before = observation
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
        if agent.actions == "goal":
            print(sentence(before, int(action), info))
    print(ending(terminated, info))
    for name, value in env.get_wrapper_attr("summary")().items():
        print(f"{name:26s}{value:10.4g}")
    env.close()
    return 0


def building(agent: Agent, args: Args) -> Env:
    """The environment of the command line. Raises `ConfigError`."""
    rest: dict[str, Any] = {"actions": below(agent), "estimator": args.estimator, "max_steps": args.steps}
    rest |= {"start": args.start, **getattr(agent, "settings", {})}
    difficulty, _, number = args.layout.partition(":")
    if not number:
        return gym.make("mecp_env/Layout-v0", layout=args.layout, **rest)
    return gym.make("mecp_env/Rooms-v0", difficulty=difficulty, split=number.partition(":")[0], **rest)


def chosen_building(layout: str) -> dict[str, int] | None:
    """The options of `reset` for DIFFICULTY:SPLIT:NUMBER, None for another layout. Raises `ConfigError`."""
    if ":" not in layout:
        return None
    number = layout.split(":", 2)[-1]
    if layout.count(":") != 2 or not number.isdecimal():
        raise ConfigError(f"layout: {layout!r:.80}, expected DIFFICULTY:SPLIT:NUMBER, such as medium:test:3")
    return {"building": int(number)}


def sentence(observation: dict[str, Any], row: int, info: Info) -> str:
    """What became of a drive."""
    goal = observation["goals"][row]
    where = f"{KINDS[int(goal[KIND])]} of room {goal[ROOM]:.0f}, {goal[PATH]:.1f} m away"
    done = f"{info['event']} after {info['periods']} steps"
    return f"{where:44s}{done:28s}{info['coverage']:7.1%} seen {info['metres']:7.1f} m driven"


def ending(terminated: bool, info: Info) -> str:
    """How the episode ended."""
    how = "no goal is left" if terminated else "the filter diverged" if info["diverged"] else "out of steps"
    return f"\n{how} after {info['period']} control steps\n"
