"""The rules of the source tree: few files at the root, no import cycles, bounded functions (CONTRIBUTING.md)."""

import pytest

from mecp_env.core.jit import NOT_COMPILED
from tests.architecture import TREES, figures, functions, imports, levels
from tests.isolation import uses

MOST = {
    "files at the root": 6,
    "import levels": 11,
    "files to change corner extraction": 3,
    "statements of slam/pipeline.py": 142,
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
        "tests/policies/test_evaluate.py": 1,
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


@pytest.mark.parametrize("tree", ["mecp_env", "agents"])
def test_functions_are_small(tree: str) -> None:
    most = {True: (8, 20), False: (6, 8)}  # arguments and complexity of compiled functions, and of all others
    too_large = [f for f in functions(tree) if f.arguments > most[f.compiled][0] or f.complexity > most[f.compiled][1]]
    assert not too_large


@pytest.mark.parametrize("what", INSIDE)
def test_tests_build_carriers_in_one_place_and_stay_outside(what: str) -> None:
    """Builders: `tests/slam/make.py` and its like, so that a carrier can change."""
    assert uses(what) == INSIDE[what]
