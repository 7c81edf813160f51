import base64
import json
import pickle
import struct
import zipfile

import gymnasium
import numpy as np
import pytest
import sb3_contrib as contrib
import torch

from mecp_env.cli import main as cli
from mecp_env.core.errors import ConfigError
from mecp_env.learning import exported, learned
from mecp_env.learning.config import WeightError
from mecp_env.learning.encoder import make_network
from mecp_env.learning.exported import NotFiniteError
from mecp_env.learning.learned import load, save_policy, write_json
from mecp_env.policies.registry import KIND, PLACE, VALID, WAIT, WEIGHTS, choices, shipped
from tests.learning.training import flipped, quick


@pytest.fixture
def folder(tmp_path):
    """The folder of a run with an untrained policy."""
    config = quick()
    write_json(tmp_path / "config.json", config.to_dict())
    save_policy(tmp_path, make_network(config), config.algorithm, {})
    return tmp_path


def explore(policy):
    """The exit code of an exploration."""
    return cli.main(["explore", str(policy), "--layout", "easy:validation:0", "--start", "random"])


def weights(folder):
    return next(folder.glob("policy-*.safetensors"))


def put(folder, data=b"", **fields):
    """Other weights with a checksum that belongs to them; other fields of `policy.json`."""
    weights(folder).write_bytes(data)
    about = {"algorithm": "maskable_ppo", "file": weights(folder).name, "sha256": learned.checksum(data)}
    write_json(folder / "policy.json", about | fields)


def refused(folder, said):
    with pytest.raises(WeightError, match=said):
        load(folder)


def test_weights_survive_the_way_through_a_file(folder):
    torch.manual_seed(1)
    policy = make_network(quick())
    save_policy(folder, policy, "maskable_ppo", {})
    again = load(folder).network
    assert all(torch.equal(a, b) for a, b in zip(policy.parameters(), again.parameters(), strict=True))
    assert len(list(folder.glob("policy-*.safetensors"))) == 1


def test_a_file_that_is_damaged_or_too_large_is_refused_before_it_is_read(folder, monkeypatch):
    flipped(weights(folder))
    refused(folder, r"SHA-256 is .*, expected")
    monkeypatch.setattr("mecp_env.learning.learned.MOST_BYTES", 100)
    refused(folder, "at most 100")


@pytest.mark.parametrize(
    ("algorithm", "network", "said"),
    [
        ("maskable_ppo", {"width": 32}, "another architecture"),
        ("ppo", {}, "maskable_ppo"),
    ],
)
def test_weights_of_another_architecture_or_algorithm_are_refused(algorithm, network, said, folder):
    config = quick(algorithm, network={"width": 16, "grid_channels": 4, "lstm": 8} | network)
    write_json(folder / "config.json", config.to_dict())
    refused(folder, said)


def test_weights_that_are_not_finite_are_refused(folder):
    policy = make_network(quick())
    with torch.no_grad():
        next(policy.parameters()).fill_(float("nan"))
    with pytest.raises(NotFiniteError):
        save_policy(folder, policy, "maskable_ppo", {})
    put(folder, learned.tensor_bytes(exported.weights_of(policy)))
    refused(folder, "not finite")


def test_bytes_that_are_no_tensors_and_files_elsewhere_are_refused(folder):
    for data in (b"", b"\x00" * 7, struct.pack("<Q", 2**60), b"PK\x03\x04" + bytes(100), pickle.dumps({"a": 1})):
        put(folder, data)
        refused(folder, "not a safetensors file")
    for name in ("../x.safetensors", "/x", None, 3, "a\0b.safetensors", "\ud800.safetensors", "x.zip"):
        put(folder, file=name)
        refused(folder, "expected the name of a file in this folder")
    fields = json.loads((folder / "config.json").read_text())
    fields["network"]["widht"] = 16
    write_json(folder / "config.json", fields)
    with pytest.raises(ConfigError, match="did you mean 'width'"):
        load(folder)


def test_what_is_no_policy_lists_those_there_are(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    for name, said in (
        ("nothing", "or a run folder"),
        ("maskable_pp", r"maskable_pp, expected one of maskable_ppo.*did you mean 'maskable_ppo'\?"),
        (tmp_path, r"no run of mecp-env train; a run folder, or a model file"),
        (tmp_path / "policy-0.safetensors", "name the folder"),
    ):
        with pytest.raises(ConfigError, match=said):
            load(name)
    with pytest.raises(ConfigError, match=r"notes\.txt is no trained policy"):
        load(tmp_path / "notes.txt", trust=True)
    write_json(tmp_path / "config.json", quick().to_dict())
    refused(tmp_path, "no policy yet")


def test_the_policy_that_comes_with_the_repository_is_small_and_explores(capsys):
    assert "maskable_ppo" in shipped()
    (found,) = (WEIGHTS / "maskable_ppo").glob("policy-*.safetensors")
    assert found.stat().st_size < 1.9e6
    assert load("maskable_ppo").actions == "goal"
    assert explore("maskable_ppo") == 0
    assert "coverage" in capsys.readouterr().out


class Payload:
    """Unpickled, it leaves a file behind."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def crafted(folder, mark):
    """A model file of Stable-Baselines3 whose pickle runs code."""
    code = base64.b64encode(pickle.dumps(Payload(mark))).decode()
    data = {"policy_class": {":type:": "x", ":serialized:": code, "__module__": "sb3_contrib.common.maskable.policies"}}
    path = folder / "model.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps(data))
    return path


def test_a_crafted_zip_does_not_run_nor_in_the_place_of_weights(folder):
    mark = folder / "it_ran"
    path = crafted(folder, mark)
    put(folder, path.read_bytes())
    refused(folder, "not a safetensors file")
    with pytest.raises(ConfigError, match="--trust"):
        load(path)
    assert explore(path) == 2
    with pytest.raises(ConfigError, match="--trust"):
        load(path.rename(folder / "weights.bin"))
    assert not mark.exists()


def test_a_zip_that_is_none_and_one_that_unpacks_without_end_are_refused(tmp_path, monkeypatch):
    def model(text, said):
        with zipfile.ZipFile(tmp_path / "model.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("data", text)
        with pytest.raises(WeightError, match=said):
            load(tmp_path / "model.zip", trust=True)

    model("[" * 200_000, "not a model file")
    model(json.dumps({"policy_class": {"__module__": "a"}}), "cannot be loaded")
    monkeypatch.setattr("mecp_env.learning.exported.MOST_UNPACKED", 1000)
    model(" " * 100_000, "unpacked")
    (tmp_path / "model.zip").write_bytes(b"no zip")
    with pytest.raises(WeightError, match="not a model file"):
        load(tmp_path / "model.zip", trust=True)


def test_a_model_whose_spaces_do_not_fit_is_refused_with_both(tmp_path):
    env = gymnasium.make("mecp_env/Rooms-v0", actions="goal", laser={"beams": 360}, observation={"scan": True})
    contrib.MaskablePPO("MultiInputPolicy", env, n_steps=2, batch_size=2, device="cpu").save(tmp_path / "scan.zip")
    other = gymnasium.make("mecp_env/Rooms-v0", actions="goal", observation={"scan": True})
    said = r"scan\.zip was trained on .*'scan': \(360,\).*, the observation has .*\(720,\)"
    with pytest.raises(ConfigError, match=said):
        load(tmp_path / "scan.zip", trust=True).act(other.reset(seed=0)[0])


def test_a_policy_without_known_ground_explores_a_task_and_never_drives_back(folder):
    """It was trained with nine columns; the rows of places are not for it, unless there is nothing else."""
    policy, env = load(folder), gymnasium.make("mecp_env/ActiveCheapRobot-v0", max_steps=80)
    observation, _ = env.reset(seed=1)
    over, chosen = False, []
    while not over:
        masks = env.get_wrapper_attr("action_masks")()
        row = policy.act(observation, masks)
        if len(choices(observation)):
            chosen.append(observation["goals"][row, KIND])
        observation, _, terminated, truncated, _ = env.step(row)
        over = terminated or truncated
    assert chosen
    assert max(chosen) < PLACE
    only_waiting = observation | {"goals": np.zeros_like(observation["goals"])}
    only_waiting["goals"][3, [KIND, VALID]] = WAIT, 1.0
    assert policy.act(only_waiting, only_waiting["goals"][:, VALID] > 0.5) == 3
