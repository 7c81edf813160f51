"""Evaluations of policies, as `mecp-env evaluate` runs them, whose episodes are units of work of a benchmark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from benchmarks.common import OptionError, Options, chosen, in_parallel
from mecp_env.policies.evaluation import Evaluation, Row
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import EpisodeResult, run_episode
from mecp_env.world.config import SPLITS

MOST = len(SPLITS["test"])  # buildings


def checked(policies: Sequence[str]) -> tuple[str, ...]:
    """The names of policies, each once. Raises `ConfigError` for an unknown one."""
    for policy in policies:
        make_policy(policy)
    return tuple(dict.fromkeys(policies))


def buildings_of(options: Options, settings: Iterable[str], each: int) -> dict[str, int]:
    """Number of buildings in each setting, or in those of --sets. Raises `OptionError` for more than the split has."""
    if options.buildings > MOST:
        raise OptionError(f"--buildings {options.buildings}: the split has {MOST}")
    counts = dict.fromkeys(settings, options.buildings or each)
    return chosen(options.sets, counts, MOST) or counts


def rows_of(evaluations: Mapping[str, Evaluation], options: Options) -> dict[str, list[Row]]:
    """The rows of each evaluation, which has all its episodes then."""
    tasks = [(name, task) for name, of in evaluations.items() for task in of.tasks()]
    units = {f"{name} {task.setting.name} {task.name}": task for name, task in tasks}
    for (name, _), result in zip(tasks, in_parallel(run_episode, EpisodeResult, units, options), strict=True):
        evaluations[name].results.append(result)
    return {name: of.rows() for name, of in evaluations.items()}
