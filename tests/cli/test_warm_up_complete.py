"""After `mecp-env warmup` the documented commands compile next to nothing.

What other tests compiled counts as compiled ahead, so `.ci/run` runs this file before them, with an empty cache.
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from mecp_env.cli import main as cli
from mecp_env.cli import warmup
from mecp_env.core import jit, warm_up
from tests.command_lines import ROOT

SMALL = "--ppo.steps 16 --ppo.batch 16 --network.width 8 --steps 32 --log.evaluate-buildings 1 --env.max-steps 60"
ALONE = "--buildings.layout two_rooms --environments 1"  # in one process
LINES = (  # as in the documents, shorter
    "doctor --seconds 1",
    "demo --layout two_rooms --out demo --save-map map.zip",
    "demo --layout paper --config.slam.filter.kind ekf --config.max-steps 60 --out ekf",
    "demo --config.laser.preset urg04lx --config.odometry.preset turtlebot --config.max-steps 150 --out urg",
    "demo --layout office --config.crowd.people 3 --config.clutter.movable-boxes 3 --config.max-steps 60 --out crowd",
    "explore gain --layout hard:7 --steps 60",
    "explore pause --task ActiveHalls-v0 --steps 150",
    "explore returning --task ActiveCorridors-v0 --steps 150",
    "explore stachniss --task ActiveCheapRobot-v0 --steps 100",
    "explore next_best_view --difficulty easy --estimator known --steps 60",
    "explore random_walk --difficulty easy --estimator truth --steps 60 --replay page",
    "evaluate nearest gain --difficulty easy --episodes 1 --max-steps 60 --known --out compared",
    "slam log.npz --out slam --save-map slam.zip",
    "slam log.npz --odometry none --out registered",
    "slam log.npz --from-map slam.zip --start unknown --out localised",
    "export slam.zip --landmarks x.csv --rooms x.geojson --grid x.yaml",
    "one-scan --step 6 --out scan",
    "replay demo --out page.html",
    "worlds stats paper hard:0",
    "worlds convert demo/belief.yaml plan.json",
)
LEARNING = (
    f"train ppo {SMALL} {ALONE} --out ppo",
    f"train maskable_ppo {SMALL} {ALONE} --out maskable",
    "explore maskable_ppo --steps 60",
)
LOST = 1  # exit code where the pose is not found in the map
FEW = 3  # functions, each for one set of types, that all commands together may compile later
SCRIPT = """
import json, sys
import numpy as np
from mecp_env.cli import main as cli
from mecp_env.cli import runs
from mecp_env.cli.warmup import made_log

runs.FRAMES = 2  # of a film, whose pixels take long and compile nothing
log = made_log()
beams = {"t": log.t, "ranges": log.ranges, "angles": log.bearings, "max_range_m": log.max_range_m}
np.savez("log.npz", odo=log.T_odom_robot, **beams)
codes = {line: cli.main(line.split()) for line in json.loads(sys.argv[1])}
with open("result.json", "w") as file:
    json.dump(codes, file)
"""


def run(*words: str, folder: Path) -> None:
    """A process that compiles what it calls."""
    environment = {"PYTHONPATH": str(ROOT), "MECP_ENV_WARM_UP": "0"}
    line = [sys.executable, *words]
    subprocess.run(line, cwd=folder, env=os.environ | environment, check=True, capture_output=True, timeout=900)


def kept() -> set[str]:
    """The functions in the cache."""
    return {path.name for path in jit.cache_directory().rglob("*.nbc")}


@pytest.mark.slow
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_the_documented_commands_compile_next_to_nothing_after_a_warm_up(tmp_path: Path) -> None:
    learning = LEARNING if all(map(installed, ("torch", "sb3_contrib"))) else ()
    run("-m", "mecp_env", "warmup", folder=tmp_path)
    warm = kept()
    run("-c", SCRIPT, json.dumps((*LINES, *learning)), folder=tmp_path)
    codes = json.loads((tmp_path / "result.json").read_text())
    assert {line: code for line, code in codes.items() if code not in (0, LOST if "unknown" in line else 0)} == {}
    assert len(warm) > 200
    assert len(kept() - warm) <= FEW, sorted(kept() - warm)


@pytest.mark.parametrize(
    ("jobs", "rows"),
    [("1", [("episode",), ("log",), ("tasks",)]), ("2", [("episode",), ("log", "tasks")])],
)
def test_warm_up_takes_as_many_processes_as_it_may(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], jobs: str, rows: list[tuple[str, ...]]
) -> None:
    driven: list[tuple[str, ...]] = []
    monkeypatch.setattr(warm_up, "compile_ahead", lambda drives, report: driven.append(drives) or ())
    assert cli.main(["warmup", "--jobs", jobs]) == 0
    assert driven == rows
    assert "functions compiled" in capsys.readouterr().out


def test_a_drive_that_fails_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert set(warm_up.FIRST + warm_up.LATER) == set(warmup.DRIVES)
    monkeypatch.setattr(warm_up, "compile_ahead", lambda drives, report: ("log",) if "log" in drives else ())
    assert cli.main(["warmup"]) == 1
    said = capsys.readouterr()
    assert "mecp_env.cli.warmup log" in said.out + said.err
    assert "functions compiled" not in said.out
    (tmp_path / "file").touch()
    monkeypatch.setattr(jit, "cache_directory", lambda: tmp_path / "file" / "cache")
    assert cli.main(["warmup"]) == 1  # where nothing can be kept


def installed(module: str) -> bool:
    """Whether a library can be imported."""
    return importlib.util.find_spec(module) is not None
