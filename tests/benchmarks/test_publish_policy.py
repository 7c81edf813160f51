import json

import pytest

pytest.importorskip("sb3_contrib")
pytest.importorskip("safetensors")

from benchmarks import publish_policy
from mecp_env.cli.base import run_command
from mecp_env.learning.encoder import make_network
from mecp_env.learning.learned import load, save_policy, write_json
from tests.learning.training import quick

HEAD = "decisions,seconds,auc,auc_error\n"
FILES = {"config.json", "run.json", "evaluation.csv", "progress.csv", "policy.json"}


def make_run(folder, areas, algorithm="maskable_ppo", width=16):
    config = quick(algorithm, network={"width": width, "grid_channels": 4, "lstm": 8})
    write_json(folder / "config.json", config.to_dict())
    save_policy(folder, make_network(config), algorithm, {"note": len(areas)})
    (folder / "run.json").write_text("[]")
    (folder / "progress.csv").write_text(f"{folder.name}\n")
    (folder / "evaluation.csv").write_text(HEAD + "".join(f"{100 * i},3600,{a},0.01\n" for i, a in enumerate(areas)))
    return folder


def main(runs, weights):
    """The exit code of publishing runs to a folder."""
    return run_command(lambda: publish_policy.publish(runs, weights))


def shipped(weights):
    """The files there with their bytes."""
    return {path.name: path.read_bytes() for path in (weights / "maskable_ppo").iterdir()}


@pytest.mark.parametrize("task", ["", "ActiveHalls-v0"])
def test_the_policy_of_the_best_run_is_shipped_with_its_curve(task, tmp_path):
    """The best by correct coverage in a task, else by the area."""
    runs = (make_run(tmp_path / "a", [0.5, 0.8]), make_run(tmp_path / "b", [0.5, 0.6], width=24))
    for run, correct in zip(runs, (0.6, 0.7), strict=True):
        write_json(run / "config.json", json.loads((run / "config.json").read_text()) | {"task": task})
        rows = (run / "evaluation.csv").read_text().splitlines()
        lines = [f"{rows[0]},correct_over_steps", *(f"{row},{correct}" for row in rows[1:])]
        (run / "evaluation.csv").write_text("\n".join(lines) + "\n")
    assert main(runs[:1], tmp_path / "weights") == 0
    assert main(runs, tmp_path / "weights") == 0  # the one before goes, with its table
    best, found = runs[bool(task)], shipped(tmp_path / "weights")
    assert found["progress.csv"] == f"{best.name}\n".encode()
    assert found.keys() == {*FILES, json.loads(found["policy.json"])["file"], "curve.png"}
    assert load(tmp_path / "weights" / "maskable_ppo").config == load(best).config
    assert len(found["curve.png"]) > 1000


def test_wrong_input_is_refused(tmp_path, capsys):
    areas = {"good": [0.5], "empty": [], "cell": [""], "infinite": ["inf"]}
    run = {name: make_run(tmp_path / name, given) for name, given in areas.items()}
    other = make_run(tmp_path / "ppo", [0.5], "ppo")
    bare, gone = make_run(tmp_path / "bare", [0.5]), make_run(tmp_path / "gone", [0.5])
    (bare / "config.json").write_text("{}")
    (gone / "config.json").unlink()
    for runs, said in (
        ((), ""),
        ((run["empty"],), ""),
        ((run["cell"],), ""),
        ((run["infinite"],), ""),
        ((run["good"], tmp_path / "none"), ""),
        ((run["good"], other), ""),
        ((bare,), f"{bare} is not a run folder: 'algorithm' is missing\n"),
        ((gone,), f"{gone} is not a run folder: "),
    ):
        assert main(runs, tmp_path / "weights") == 2
        told = capsys.readouterr().err
        assert told.startswith(f"mecp-env: runs: {said}")
        assert "Error" not in told


@pytest.mark.parametrize("wrong", ["large", "incomplete", "itself", "no folder"])
def test_what_is_shipped_stays_when_a_run_cannot_take_its_place(wrong, tmp_path, capsys, monkeypatch):
    weights, run = tmp_path / "weights", make_run(tmp_path / "b", [0.6])
    assert main((make_run(tmp_path / "a", [0.5]),), weights) == 0
    before = shipped(weights)
    if wrong == "incomplete":
        (run / "run.json").unlink()
    monkeypatch.setattr("benchmarks.publish_policy.MOST_BYTES", 100 if wrong == "large" else 10**9)
    runs = (weights / "maskable_ppo" if wrong == "itself" else run,)
    assert main(runs, run / "run.json" if wrong == "no folder" else weights) == 2
    assert "mecp-env: " in capsys.readouterr().err
    assert shipped(weights) == before
