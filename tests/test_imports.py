"""Import rules (import-linter), and the cost of `import mecp_env`."""

from pathlib import Path

from tests.processes import run_python

ROOT = Path(__file__).parent.parent
HEAVY = ("numba", "scipy", "matplotlib", "pygame", "pymunk", "shapely", "PIL", "torch", "pydantic")


def test_the_import_contracts_hold() -> None:
    code = "import os, sys; from importlinter.cli import lint_imports; sys.exit(lint_imports())"
    run_python(code.replace("sys;", f"sys; os.chdir({str(ROOT)!r});"))


def test_the_package_and_the_estimator_at_hand_load_nothing_heavy() -> None:
    code = "import sys, mecp_env, mecp_env.slam; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = set(run_python(code).split())
    assert "gymnasium" in loaded
    assert not set(HEAVY) & loaded
    from mecp_env import slam

    assert all(getattr(slam, name).__name__ == name for name in slam.__all__)
    assert not hasattr(slam, "SlamPipelin")


def test_the_estimator_loads_without_the_world_and_without_pictures() -> None:
    loaded = set(run_python("import sys, mecp_env.slam.pipeline; print(*sys.modules)").split())
    assert not {"pymunk", "pygame", "shapely", "matplotlib"} & loaded
    assert not {name for name in loaded if name.startswith(("mecp_env.world", "mecp_env.env", "mecp_env.render"))}
