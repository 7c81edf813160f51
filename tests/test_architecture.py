"""The rules of the source tree: few files at the root, imports, bounded functions (CONTRIBUTING.md)."""

import pytest

from mecp_env import slam
from mecp_env.core.jit import NOT_COMPILED
from tests.architecture import ROOT, TREES, figures, functions, imports, levels
from tests.isolation import uses
from tests.processes import run_python

HEAVY = {"numba", "scipy", "matplotlib", "pygame", "pymunk", "shapely", "PIL", "torch", "pydantic"}

MOST = {
    "files at the root": 6,
    "import levels": 11,
    "files to change corner extraction": 3,
    "code lines of slam/pipeline.py": 136,
    "compiled functions": 288,
    "compiled functions with more than 8 arguments": 0,
    "tunable numbers of the estimator": 84,
}


INSIDE = {  # how often a file of the tests does what one should not; may only become less
    "carriers": {"tests/env/test_goal_actions.py": 1, "tests/planning/test_known_ground.py": 1},
    "private names": {
        "tests/benchmarks/test_kiss.py": 1,
        "tests/benchmarks/test_stock_ppo.py": 4,  # of multiprocessing
        "tests/conftest.py": 1,
        "tests/env/helpers.py": 2,
        "tests/env/test_goal_actions.py": 1,
        "tests/slam/panorama/test_registration.py": 1,
        "tests/world/rays.py": 1,
    },
}


@pytest.mark.parametrize("what", MOST)
def test_the_tree_keeps_its_bounds(what: str) -> None:
    assert figures()[what] <= MOST[what]


def test_folders_that_are_not_compiled_have_no_compiled_functions() -> None:
    """An edit there compiles nothing again; that nothing else imports them is a contract of the import linter."""
    compiled = [f.where for f in functions("mecp_env") if f.compiled]
    assert compiled
    assert not [where for where in compiled if where.split("/")[1] in NOT_COMPILED]


@pytest.mark.parametrize("tree", TREES)
def test_no_import_cycles(tree: str) -> None:
    assert levels(imports(tree)) >= 1  # raises ValueError that names the cycle


def test_the_import_contracts_hold() -> None:
    run_python(f"import os, sys, importlinter.cli as c; os.chdir({str(ROOT)!r}); sys.exit(c.lint_imports())")


def test_the_package_and_the_estimator_at_hand_load_nothing_heavy() -> None:
    code = "import sys, mecp_env, mecp_env.slam; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = set(run_python(code).split())
    assert "gymnasium" in loaded
    assert not HEAVY & loaded
    assert all(getattr(slam, name).__name__ == name for name in slam.__all__)
    assert not hasattr(slam, "SlamPipelin")


def test_the_estimator_loads_without_the_world_and_without_pictures() -> None:
    loaded = set(run_python("import sys, mecp_env.slam.pipeline; print(*sys.modules)").split())
    assert not {"pymunk", "pygame", "shapely", "matplotlib"} & loaded
    assert not {name for name in loaded if name.startswith(("mecp_env.world", "mecp_env.env", "mecp_env.render"))}


@pytest.mark.parametrize("tree", ["mecp_env", "agents"])
def test_functions_are_small(tree: str) -> None:
    most = {True: (8, 20), False: (6, 8)}  # arguments and complexity of compiled functions, and of all others
    too_large = [f for f in functions(tree) if f.arguments > most[f.compiled][0] or f.complexity > most[f.compiled][1]]
    assert not too_large


@pytest.mark.parametrize("what", INSIDE)
def test_tests_build_carriers_in_one_place_and_stay_outside(what: str) -> None:
    """Builders: `tests/slam/make.py` and its like, so that a carrier can change."""
    assert uses(what) == INSIDE[what]
