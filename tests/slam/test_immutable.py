"""Messages are immutable in fact: over whole drives, no stage writes to an array of a message after it was made."""

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.slam import messages
from mecp_env.slam.messages import NO_ID, Decision, FeatureTable, Match

MESSAGES = [
    cls for cls in vars(messages).values() if isinstance(cls, type) and is_dataclass(cls) and cls is not FeatureTable
]
CROWD = {"crowd": {"people": 4}, "clutter": {"movable_boxes": 3}}


def digest(message: Any) -> str:
    """A hash of the arrays, numbers and texts of a message; messages inside it are watched on their own."""
    found = hashlib.sha256()
    for name in (f.name for f in fields(message)):
        value = getattr(message, name)
        if isinstance(value, np.ndarray):
            found.update(value.tobytes())
        elif isinstance(value, int | float | str):
            found.update(repr(value).encode())
    return found.hexdigest()


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, str]]:
    """Every message made since, with its hash at that moment."""
    kept: list[tuple[Any, str]] = []

    def watch(cls: type, plain: Any) -> Any:
        def made_and_noted(self: Any, *args: Any, **keywords: Any) -> None:
            plain(self, *args, **keywords)
            kept.append((self, digest(self)))

        return made_and_noted

    for cls in MESSAGES:
        monkeypatch.setattr(cls, "__init__", watch(cls, cls.__init__))
    return kept


@pytest.mark.parametrize(
    "keywords", [CROWD, {"slam": {"association": {"method": "mecp_paper"}}}], ids=["ours", "paper"]
)
def test_no_stage_writes_to_a_message(made: list[tuple[Any, str]], keywords: dict[str, Any]) -> None:
    env = gym.make("mecp_env/Layout-v0", layout="two_rooms", laser={"preset": "paper"}, **keywords)
    env.reset(seed=3)
    kinds: set[type] = set()
    before: list[tuple[Any, str]] = []
    for step in range(40):
        env.step(np.array([0.7, 0.5 * np.sin(0.15 * step)], np.float32))
        changed = [type(message).__name__ for message, at_first in before + made if digest(message) != at_first]
        assert not changed
        kinds |= {type(message) for message, _ in made}
        before = made[:]  # looked at once more, after the next step
        made.clear()
    assert Match in kinds
    assert len(kinds) > 10


def test_the_output_keeps_what_the_associator_decided() -> None:
    """The third scan at rest: corners that were new for the associator have a track in the final match."""
    env = gym.make("mecp_env/Layout-v0", layout="two_rooms", slam={"tracks": {"few_matches": 0}}).unwrapped
    env.reset(seed=3)
    associated, final = env.slam_output.associated, env.slam_output.match
    followed = final.decision == int(Decision.PROVISIONAL)
    assert followed.any()
    assert (final.ids[followed] >= 0).all()
    assert (associated.decision[followed] == int(Decision.NEW)).all()
    assert (associated.ids[followed] == NO_ID).all()
