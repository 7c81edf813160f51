"""TorchScript and ONNX files with a JSON file beside them."""

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from mecp_env.core.errors import ConfigError
from mecp_env.policies.registry import Policy, make_policy, policy_checksum
from mecp_env.policies.rollout import EpisodeTask, options_of, run_episode
from mecp_env.policies.setting import Setting

EASY = Setting("easy", "validation", "slam", 15)


class Flat(torch.nn.Module):  # type: ignore[misc, name-defined]
    """As many numbers as there are actions, the last the largest."""

    def __init__(self, count: int) -> None:
        super().__init__()
        self.count = count

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return torch.arange(self.count, dtype=torch.float32)[None] + 0.0 * seen.to(torch.float32).sum()


class Poses(torch.nn.Module):  # type: ignore[misc, name-defined]
    """A velocity from the part `pose`."""

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        return seen["pose"][:, :2] * 100.0 + 5.0


class Value(torch.nn.Module):  # type: ignore[misc, name-defined]
    """One number, whatever it sees."""

    def __init__(self, value: float) -> None:
        super().__init__()
        self.value = value

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return torch.full((1,), self.value)


def script(folder: Path, module: Any, **fields: Any) -> str:
    """A TorchScript file with its JSON."""
    path = folder / "mine.pt"
    torch.jit.script(module).save(str(path))
    path.with_suffix(".json").write_text(json.dumps(fields))
    return str(path)


@pytest.mark.parametrize(
    ("module", "fields", "last"),
    [
        (Flat(5), {"observation": "flat", "actions": "discrete"}, 4),
        (Flat(32), {"observation": "image", "actions": "goal"}, 0),  # the last row that the mask allows
        (Poses(), {"actions": "velocity"}, 1.0),  # cut to its bound
    ],
)
def test_a_script_is_scored_on_what_its_json_names(
    module: Any, fields: dict[str, Any], last: Any, tmp_path: Path
) -> None:
    path = script(tmp_path, module, **fields)
    policy: Policy = make_policy(path, trust=True)
    env = gymnasium.make("mecp_env/Rooms-v0", difficulty="easy", **options_of(policy))
    mask = np.arange(32) == 0 if fields["actions"] == "goal" else None
    assert np.all(policy.act(env.reset(seed=0)[0], mask) == last)
    assert run_episode(EpisodeTask(path, 0, EASY, trust=True)).figures["periods"] > 0


def test_a_model_is_offered_the_rows_that_its_json_names(tmp_path: Path) -> None:
    rows = {"known_ground": {"places": 1, "wait_steps": 0}}
    seen = {"format": "flat", "uncertainty": True}
    path = script(tmp_path, Flat(32), observation=seen, actions="goal", planning=rows)
    env = gymnasium.make("mecp_env/ActiveHalls-v0", **options_of(make_policy(path, trust=True)))
    known = env.unwrapped.config.planning.known_ground
    assert (known.places, known.wait_steps) == (1, 0)
    path = script(tmp_path, Flat(32), observation=seen, actions="goal", planning={"known_ground": {"places": -1}})
    with pytest.raises(ConfigError, match=r"planning.known_ground.places: .*given: -1"):
        make_policy(path, trust=True)


def test_a_drawn_action_follows_from_the_seed(tmp_path: Path) -> None:
    policy = make_policy(
        script(tmp_path, Flat(5), observation="flat", actions="discrete", deterministic=False), trust=True
    )
    drawn = []
    for seed in (1, 1, 2):
        policy.reset(seed)
        drawn.append([policy.act(np.zeros(104, np.float32)) for _ in range(30)])  # type: ignore[arg-type]
    assert drawn[0] == drawn[1] != drawn[2]
    assert len(set(drawn[0])) > 1


def test_a_script_needs_trust_and_its_json(tmp_path: Path) -> None:
    path = script(tmp_path, Flat(7), observation="flat", actions="discrete")
    with pytest.raises(ConfigError, match="use --trust"):
        make_policy(path)
    before = policy_checksum(path)
    for text, message in (
        ('{"actions": "gaol"}', "did you mean 'goal'"),
        ("[1]", "expected an object"),
        ("{", "not JSON"),
    ):
        Path(path).with_suffix(".json").write_text(text)
        with pytest.raises(ConfigError, match=message):
            make_policy(path, trust=True)
    assert policy_checksum(path) != before
    Path(path).with_suffix(".json").unlink()
    with pytest.raises(ConfigError, match=r"mine\.json is missing beside it"):
        make_policy(path, trust=True)
    Path(path).write_bytes(b"no archive")
    with pytest.raises(ConfigError, match="cannot be loaded as TorchScript"):
        make_policy(path, trust=True)


@pytest.mark.parametrize(
    ("module", "fields", "message"),
    [
        (Poses(), {"observation": "flat", "actions": "velocity"}, r"cannot act on the observation \(104,\): .*Tensor"),
        (Value(2.7), {"observation": "flat", "actions": "discrete"}, r"returned 1 numbers \(\[2.7\]\), expected 5"),
        (Flat(7), {"observation": "flat", "actions": "discrete"}, r"returned 7 numbers .*, expected 5 numbers"),
    ],
)
def test_an_output_that_is_no_action_is_one_line(module: Any, fields: Any, message: str, tmp_path: Path) -> None:
    path = Path(script(tmp_path, module, **fields))
    other = path.rename(path.with_suffix(".pth"))  # the content decides, not the name
    with pytest.raises(ConfigError, match=message):
        make_policy(str(other), trust=True).act(np.zeros(104, np.float32))  # type: ignore[arg-type]


class Session:
    """Stands for an inference session: returns as many numbers as the file's text says."""

    def __init__(self, path: str, providers: list[str]) -> None:
        self.count = int(Path(path).read_text())

    def get_inputs(self) -> list[Any]:
        return [SimpleNamespace(name="seen")]

    def run(self, outputs: None, inputs: dict[str, Any]) -> list[Any]:
        assert inputs["seen"].shape[0] == 1
        return [np.arange(self.count, dtype=np.float32)[None]]


def test_onnx_runs_in_onnxruntime_without_trust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "mine.onnx"
    path.write_text("5")
    path.with_suffix(".json").write_text('{"observation": "flat", "actions": "discrete"}')
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match="needs onnxruntime"):
        make_policy(str(path))
    module: Any = ModuleType("onnxruntime")
    module.InferenceSession = Session
    monkeypatch.setitem(sys.modules, "onnxruntime", module)
    assert make_policy(str(path)).act(np.zeros(104, np.float32)) == 4  # type: ignore[arg-type]
    assert run_episode(EpisodeTask(str(path), 0, EASY)).figures["decisions"] > 0
    path.write_text("none")
    with pytest.raises(ConfigError, match="cannot be loaded as ONNX"):
        make_policy(str(path))
