from __future__ import annotations

import json

import pytest

from agents.publish import Args, main

HEAD = "decisions,seconds,auc,auc_error\n"


def make_run(folder, areas, algorithm="maskable_ppo", size=100):
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps({"algorithm": algorithm}))
    (folder / "run.json").write_text("[]")
    (folder / "policy.json").write_text(json.dumps({"file": "policy-a.safetensors"}))
    (folder / "policy-a.safetensors").write_bytes(bytes([len(areas)]) * size)
    (folder / "evaluation.csv").write_text(HEAD + "".join(f"{100 * i},3600,{a},0.01\n" for i, a in enumerate(areas)))
    return folder


def test_the_policy_of_the_best_run_is_shipped_with_its_curve(tmp_path):
    runs = (make_run(tmp_path / "a", [0.5, 0.8]), make_run(tmp_path / "b", [0.5, 0.6, 0.7]))
    assert main(Args(runs, tmp_path / "weights")) == 0
    shipped = tmp_path / "weights" / "maskable_ppo"
    assert (shipped / "policy-a.safetensors").read_bytes()[0] == 2
    assert {path.name for path in shipped.iterdir()} == {
        *("config.json", "run.json", "evaluation.csv", "policy.json", "policy-a.safetensors", "curve.png")
    }


def test_only_the_picture(tmp_path):
    picture = tmp_path / "curve.png"
    assert main(Args((make_run(tmp_path / "a", [0.5]),), tmp_path / "weights", picture, ship=False)) == 0
    assert picture.stat().st_size > 1000
    assert not (tmp_path / "weights").exists()


@pytest.mark.parametrize("wrong", ["missing", "mixed", "empty", "large"])
def test_wrong_input_is_refused(wrong, tmp_path, capsys):
    first = make_run(tmp_path / "a", [] if wrong == "empty" else [0.5], size=2_000_000 if wrong == "large" else 10)
    more = {"missing": (tmp_path / "none",), "mixed": (make_run(tmp_path / "b", [0.5], "ppo"),)}
    assert main(Args((first, *more.get(wrong, ())), tmp_path / "weights")) == 2
    assert "publish:" in capsys.readouterr().err
