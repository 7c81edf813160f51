"""The scripts of `agents/` run from start to end with small settings."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.bfs import RoomByRoom
from mecp_env.policies.explorers import BreadthFirstPolicy
from tests.launcher import Launcher
from tests.policies.scenes import goal, observation

ROOT = Path(__file__).parents[2]
SMALL = "--steps 8 --environments 2 --difficulty easy --rollout 4 --batch 4 --validation 1 --max-steps 20"


def run_script(launcher: Launcher, name: str, folder: Path, *options: str) -> str:
    """What a script prints; it runs in another folder, with nothing but `mecp_env` to import."""
    path = str(ROOT / "agents" / f"{name}.py")
    code = f"import runpy, sys; sys.path[0] = {str(ROOT / 'agents')!r}; runpy.run_path({path!r}, run_name='__main__')"
    done = launcher.start(code, *options, cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)})
    printed, _ = done.communicate()
    assert done.returncode == 0, printed
    return printed


@pytest.mark.slow
def test_breadth_first_explores(launcher: Launcher, tmp_path: Path) -> None:
    printed = run_script(launcher, "bfs", tmp_path, "--layout", "two_rooms")
    assert "rooms_found                        2" in printed
    assert list(tmp_path.iterdir()) == []


def test_the_example_selects_as_the_policy_of_the_package() -> None:
    rng = np.random.default_rng(0)
    for count in (0, 1, 5, 20):
        goals = [goal(*rng.uniform(-5, 5, 2), rng.uniform(0, 9), int(rng.integers(4))) for _ in range(count)]
        seen = observation(*goals)
        seen["goals"][:, 5:7] = rng.integers(0, 3, (32, 2))
        mask = rng.random(32) < 0.7
        for given in (None, mask):
            assert RoomByRoom().act(seen, given) == BreadthFirstPolicy().act(seen, given)


@pytest.mark.slow
def test_training_ends_with_weights(launcher: Launcher, tmp_path: Path) -> None:
    pytest.importorskip("sb3_contrib")
    options = f"{SMALL} --out {tmp_path / 'w.safetensors'}"
    assert "on the validation split" in run_script(launcher, "train_maskable_ppo", tmp_path, *options.split())
    assert (tmp_path / "w.safetensors").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("learner", "steps"), [("ppo", 520), ("ppo --actions goal --shaping 0.1", 200), ("maskable_ppo", 200)]
)
def test_the_first_training_writes_model_and_curve(
    launcher: Launcher, learner: str, steps: int, tmp_path: Path
) -> None:
    pytest.importorskip("sb3_contrib")
    options = f"--algorithm {learner} --steps {steps} --buildings 1 --environments 2 --max-steps 60 --out {tmp_path}"
    run_script(launcher, "train_first", tmp_path, *options.split())
    rows = np.genfromtxt(tmp_path / "seed-0" / "progress.csv", delimiter=",", names=True)
    assert rows["steps"][0] == 0
    assert rows["steps"][-1] >= steps
    assert 0.0 < rows["coverage"][-1] <= 1.0
    assert (tmp_path / "seed-0" / "model.zip").stat().st_size > 10_000
    assert (tmp_path / "curve.png").stat().st_size > 10_000


@pytest.mark.parametrize("algorithm", ["maskable_ppo", "first"])
def test_without_stable_baselines_a_script_says_in_one_line_what_to_install(algorithm: str, tmp_path: Path) -> None:
    for name in ("stable_baselines3", "sb3_contrib"):
        (tmp_path / f"{name}.py").write_text(f"raise ModuleNotFoundError('none', name={name!r})")
    environ = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    command = [sys.executable, str(ROOT / "agents" / f"train_{algorithm}.py")]
    done = subprocess.run(command, capture_output=True, text=True, env=environ)
    assert done.returncode == 1
    assert "is not installed; install the extra `rl`" in done.stderr
    assert done.stderr.count("\n") == 1
