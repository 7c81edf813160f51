"""Import rules (import-linter), and the cost of `import mecp_env`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
HEAVY = ("numba", "scipy", "matplotlib", "pygame", "pymunk", "shapely", "PIL", "torch", "stable_baselines3")


def run_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_import_contracts_hold() -> None:
    code = "import sys; sys.path.insert(0, '.'); from importlinter.cli import lint_imports; sys.exit(lint_imports())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


def test_import_of_the_package_loads_nothing_heavy() -> None:
    loaded = run_python("import sys, mecp_env; print(*{name.partition('.')[0] for name in sys.modules})").split()
    assert "gymnasium" in loaded
    assert not set(HEAVY) & set(loaded)


def test_the_estimator_loads_without_the_world_and_without_pictures() -> None:
    loaded = set(run_python("import sys, mecp_env.slam.pipeline; print(*sys.modules)").split())
    assert not {"pymunk", "pygame", "shapely", "matplotlib"} & loaded
    assert not {name for name in loaded if name.startswith(("mecp_env.world", "mecp_env.env", "mecp_env.render"))}


def test_the_estimator_is_at_hand_and_loads_when_it_is_used() -> None:
    code = """if True:
        import sys, mecp_env.slam as slam
        print("numba" in sys.modules)
        from mecp_env.slam import Odometry, Scan, SlamConfig, SlamPipeline
        print(all(getattr(slam, name).__name__ == name for name in slam.__all__), hasattr(slam, "SlamPipelin"))"""
    assert run_python(code).split() == ["False", "True", "False"]


def test_the_package_is_typed_and_carries_its_layouts() -> None:
    assert (ROOT / "mecp_env" / "py.typed").is_file()
    assert len(list((ROOT / "mecp_env" / "world" / "library").glob("*.json"))) >= 5
