"""Policies by name: shipped explorers, trained policies, run folders, and classes as `module:Class`.

The interface of a policy, and the columns of its observation.
"""

from __future__ import annotations

import importlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mecp_env import TRAINED
from mecp_env.core.carriers import Bools, Ints
from mecp_env.core.errors import ActionError, ConfigError, MecpError
from mecp_env.core.files import exists, is_folder, read_json
from mecp_env.core.processes import Failure
from mecp_env.core.provenance import checksum
from mecp_env.core.settings import as_many, guess, load_parts, shown

Mask = Bools | None

X, Y, PATH, SIZE, KIND, ROOM, LEVEL, VISITS, VALID = range(9)  # columns of `goals`
SIGMA, SIGMA_RAD, GAIN = 9, 10, 11  # of those with `uncertainty`
KINDS = ("open edge", "door candidate", "frontier", "door", "place", "wait", "look")
PLACE, WAIT, LOOK = 4, 5, 6


class Policy(Protocol):
    """Maps observations to actions; it receives the observation and nothing else."""

    actions: str  # the action mode that it needs of the environment: "goal", "velocity" or "discrete"

    def reset(self, seed: int = 0) -> None:
        """Start an episode; all randomness in it follows from `seed`."""

    def act(self, observation: dict[str, Any], mask: Mask = None) -> Any:
        """An action of that mode; `mask` (32,) excludes rows of `goals`, None for other actions."""


def choices(observation: dict[str, Any], mask: Mask = None) -> Ints:
    """(k,) the rows of the observation's goals that have something left to see and may be selected."""
    return rows_where(observation["goals"][:, KIND] < PLACE, observation, mask)


def of_kind(kind: int, observation: dict[str, Any], mask: Mask = None) -> Ints:
    """(k,) the rows of that kind that may be selected."""
    return rows_where(observation["goals"][:, KIND] == kind, observation, mask)


def rows_where(wanted: Bools, observation: dict[str, Any], mask: Mask) -> Ints:
    """(k,) the wanted rows (n,) that hold a goal and may be selected."""
    held = wanted & (observation["goals"][:, VALID] > 0.5)
    return np.flatnonzero(held if mask is None else held & np.asarray(mask, np.bool_))


EXPLORERS = {  # name -> "module:Class", constructed without arguments
    "bfs": "mecp_env.policies.explorers:BreadthFirstPolicy",
    "nearest": "mecp_env.policies.explorers:Nearest",
    "next_best_view": "mecp_env.policies.explorers:NextBestView",
    "gain": "mecp_env.policies.explorers:Gain",
    "pause": "mecp_env.policies.active:Pause",
    "returning": "mecp_env.policies.active:Returning",
    "stachniss": "mecp_env.policies.active:Stachniss",
    "random_goal": "mecp_env.policies.explorers:RandomGoal",
    "random_walk": "mecp_env.policies.explorers:RandomWalk",
    "standing": "mecp_env.policies.explorers:Standing",
}
OURS = tuple(EXPLORERS)
LEARNED = ("ppo", "maskable_ppo", "recurrent_ppo")  # the algorithms of `mecp-env train`
WEIGHTS = Path(__file__).parents[1] / "learning" / "weights"
MOST_BYTES = 1_000_000  # of policy.json
NAMED = re.compile(r"vec_?normalize", re.IGNORECASE)  # in the names of statistics of VecNormalize
STATISTICS, MOST_STATISTICS = b"VecNormalize", 100_000_000  # what their pickle contains, and its most bytes
INSTALL = "install the extra `rl`: pip install 'mecp_env[rl]' (PyTorch first, see the README)"
CLASS_PATH = re.compile(r"(\w[\w. -]*):([A-Za-z_]\w*)")  # of a file with any name, too: `my-policies/2nd one.py`
FILE_PATH = re.compile(r"(.+)\.py:(\w+)")
INTERFACE = ("actions", "reset", "act")


def make_policy(name: str, trust: bool = False) -> Policy:
    """The policy of that name, a class `module:Class`, or the trained one in the run folder or model file `name`.

    Raises `ConfigError` for an unknown name, with a suggestion, for a trained policy without PyTorch, and for a model
    file of Stable-Baselines3 without `trust`: it may run arbitrary code while it is loaded.
    """
    found = CLASS_PATH.fullmatch(EXPLORERS.get(name, source_of(name)))
    if found:
        return import_policy(found[1], found[2])
    if name in LEARNED or (name and exists(Path(name))):
        return load_learned(name, trust)
    known = policy_names()
    beside = [str(path) for path in Path(name).parent.glob("*")] if name and is_folder(Path(name).parent) else []
    raise ConfigError(
        f"policy: {name!r:.80}: no such file or run folder, expected one of {', '.join(known)}, module:Class, or "
        f"file.py:Class below the working directory{guess(name, [*known, *beside])}"
    )


@contextmanager
def calls_of(name: str, fault: str = "failed", plain: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """What a policy of the user raises in `reset` or `act` becomes a `ConfigError` that names it and the line.

    `fault`: what the policy did, in words; errors of the types `plain` need no line. Wrong actions name it, too.
    """
    try:
        yield
    except ActionError as error:
        raise ConfigError(f"policy: {name!r:.80} returned a wrong {error}") from None
    except MecpError:
        raise
    except SystemExit as error:
        raise ConfigError(f"policy: {name!r:.80} ends the process ({ended(error)})") from None
    except Exception as error:  # code of the user may raise anything
        reason = error if isinstance(error, plain) else Failure.of(error).reason
        raise ConfigError(f"policy: {name!r:.80} {fault}: {reason}") from error


def ended(error: SystemExit) -> str:
    """What code said that ended its process, in a few words."""
    return f"SystemExit: {error.code!s:.80}"


def register_policy(name: str, path: str) -> None:
    """Let `name` stand for a policy, a class given as "module:Class", which worker processes can import, too.

    A name that was registered before is replaced. Raises `ConfigError` for a name of ours, for what is no name, and for
    what is no path of a class.
    """
    ours = (*OURS, *LEARNED)
    if not isinstance(name, str) or not name.isidentifier() or name in ours:
        known = ", ".join(ours)
        raise ConfigError(f"name: {shown(name)}, a new name of letters, digits and _ expected (ours: {known})")
    if not isinstance(path, str) or not CLASS_PATH.fullmatch(path):
        raise ConfigError(f"path: {shown(path)}, expected the text 'module:Class', which worker processes can import")
    EXPLORERS[name] = path


def source_of(name: str) -> str:
    """What `make_policy` makes a policy from in any process: the class of a registered name, else the name itself.

    `folder/file.py:Class`, below the working directory, is the class `folder.file:Class`.
    """
    if found := FILE_PATH.fullmatch(name):
        return f"{os.path.relpath(found[1]).replace(os.sep, '.')}:{found[2]}"
    if name.isidentifier() and name not in (*EXPLORERS, *LEARNED):
        load_parts()
    return name if name in OURS else EXPLORERS.get(name, name)


def policy_checksum(name: str) -> str:
    """Of the files that hold the class, the weights or the model of a policy; "" for those of the package.

    A class names others that it reads in its attribute `files`. Raises `ConfigError` for one that is no file.
    """
    found, path = CLASS_PATH.fullmatch(source_of(name)), Path(name)
    paths: list[Path | None] = [path / "policy.json"]  # which contains the checksum of the weights
    if found:
        module = importlib.import_module(found[1])
        paths = [Path(str(module.__file__)), *files_of(getattr(module, found[2]), name)]
    elif path.is_file():
        exported = path.suffix in (".pt", ".pth", ".onnx")
        paths = [path, path.with_suffix(".json"), None if exported else statistics_of(path)]
    data = [path.read_bytes() for path in paths if path is not None and path.is_file()]
    return checksum(b"".join(data)) if data else ""


def files_of(policy: Any, name: str) -> list[Path]:
    """The files that a class names in `files`. Raises `ConfigError` for what is none.

    A wrong path must not pass: with new weights, the episodes of the old ones would be kept.
    """
    given = as_many(getattr(policy, "files", ()))
    if not isinstance(given, list | tuple) or not all(isinstance(path, str | os.PathLike) for path in given):
        raise ConfigError(f"policy: {name!r:.80}: files {shown(given)}, expected a tuple of paths")
    paths = [Path(path) for path in given]
    if missing := [str(path) for path in paths if not path.is_file()]:
        raise ConfigError(f"policy: {name!r:.80}: files: {', '.join(missing)}: no such file")
    return paths


def statistics_of(model: Path) -> Path | None:
    """The file with the statistics of `VecNormalize` that belongs to a model file in its folder; None without one.

    It has the name of the model and the word "vecnormalize" in any place, or only the word. Raises `ConfigError` where
    such statistics have a name that belongs to no model: without them the score would be wrong, and nobody would know.
    """
    found = statistics_in(model.parent)
    for stem in (stem_of(model), ""):
        if stem in found:
            return found[stem]
    models = {stem_of(path) for path in model.parent.iterdir() if path.suffix != ".pkl"}
    unknown = [path.name for stem, path in found.items() if stem not in models]
    if unknown:
        raise ConfigError(
            f"policy: {model}: beside it are the statistics {', '.join(unknown)}; name those of this model "
            f"{model.stem}_vecnormalize.pkl, and remove others"
        )
    return None


def statistics_in(folder: Path) -> dict[str, Path]:
    """The files with statistics of `VecNormalize` in a folder, by name or content, under their `stem_of`."""
    files = [path for path in sorted(folder.glob("*.pkl")) if path.is_file() and path.stat().st_size <= MOST_STATISTICS]
    return {stem_of(path): path for path in files if NAMED.search(path.stem) or STATISTICS in path.read_bytes()}


def stem_of(path: Path) -> str:
    """The letters and digits of a file's name without its suffix and the word "vecnormalize"."""
    return re.sub(r"[\W_]", "", NAMED.sub("", path.stem))


def training_hours(name: str) -> float | None:
    """The hours that the training of a shipped policy or a run folder took; None for other policies."""
    folder = WEIGHTS / name if name in LEARNED else Path(name)
    if not (folder / "policy.json").is_file():
        return None
    try:
        about = read_json(folder / "policy.json", MOST_BYTES)
    except ValueError as error:
        raise ConfigError(f"{folder / 'policy.json'}: {error!s:.200}") from None
    seconds = about.get("seconds") if isinstance(about, dict) else None
    return round(seconds / 3600.0, 2) if isinstance(seconds, int | float) else None


def import_policy(module: str, class_name: str) -> Policy:
    """An instance of a class; modules in the working directory are found, too. Raises `ConfigError`."""
    name = f"{module}:{class_name}"
    find_modules_here()
    with calls_of(name, "cannot be constructed", (ImportError, AttributeError, TypeError)):
        policy: Policy = getattr(importlib.import_module(module), class_name)()
        missing = [part for part in INTERFACE if not hasattr(policy, part)]
    if missing:
        raise ConfigError(
            f"policy: {name!r} has no {', '.join(map(repr, missing))}; every policy has actions ('goal', 'discrete' or "
            "'velocity'), reset(seed) and act(observation, mask)"
        )
    return policy


def find_modules_here() -> None:
    """Let `import` find modules in the working directory, which the installed command does not."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


def load_learned(name: str, trust: bool = False) -> Policy:
    """The trained policy of a name, a run folder or a file; only this loads PyTorch."""
    if Path(name).suffix == ".py":
        raise ConfigError(f"policy: {name!r:.80} is source code; name a class in it, as {Path(name).name}:MyPolicy")
    module, _, load = TRAINED.get(Path(name).suffix, TRAINED[""]).partition(":")
    try:
        policy: Policy = getattr(importlib.import_module(module), load)(name, trust)
    except ModuleNotFoundError as error:
        raise ConfigError(f"policy: {name!r} is a trained policy and needs {error.name}; {INSTALL}") from None
    return policy


def shipped() -> list[str]:
    """The names of the trained policies that the package contains."""
    return [name for name in LEARNED if (WEIGHTS / name / "policy.json").is_file()]


def policy_names() -> list[str]:
    """The known names: explorers, and the trained policies that the package contains."""
    return [*EXPLORERS, *shipped()]
