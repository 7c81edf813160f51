"""The cache of compiled functions: stale, damaged, unwritable, switched off; each in a process of its own."""

import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

import mecp_env
from mecp_env.core.jit import KEPT
from tests.launcher import Launcher
from tests.processes import run_python

PACKAGE = Path(mecp_env.__file__).parent
CALLED = (
    "from mecp_env.core.jit import compiled\n\nADDED = 1.0\n\n\n"
    "@compiled\ndef called(x: float) -> float:\n    return x + ADDED\n"
)
CALLER = (
    "from mecp_env.core.jit import compiled\nfrom mecp_env.called import called\n\n\n"
    "@compiled\ndef caller(x: float) -> float:\n    return 2.0 * called(x)\n"
)
IMPORT = "from mecp_env.caller import caller, called\n"
CALL = IMPORT + "print(caller(1.0), sum(caller.stats.cache_misses.values()))"
COMPILED, LOADED = (4.0, 1), (4.0, 0)


class Tree:
    """A small package with two compiled functions, one calling the other, and a separate cache."""

    def __init__(self, folder: Path, launcher: Launcher) -> None:
        self.launcher = launcher
        self.package, self.cache = folder / "mecp_env", folder / "cache"
        (self.package / "core").mkdir(parents=True)
        for name in ("interrupts.py", "jit.py"):
            shutil.copy(PACKAGE / "core" / name, self.package / "core")
        (self.package / "core" / "__init__.py").touch()
        (self.package / "__init__.py").touch()
        (self.package / "caller.py").write_text(CALLER)
        (self.package / "called.py").write_text(CALLED)

    def edit(self, old: str, new: str) -> None:
        """Change the called function."""
        called = self.package / "called.py"
        called.write_text(called.read_text().replace(old, new))

    def call(self, code: str = CALL, **environment: str) -> tuple[float, int]:
        """What a new process prints: by default caller(1.0), and how many of its variants were compiled."""
        return self.run(code, **environment)[0]

    def run(self, code: str = CALL, **environment: str) -> tuple[tuple[float, int], list[str]]:
        """The same, and the lines before."""
        variables = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
        variables |= {"NUMBA_CACHE_DIR": str(self.cache), "PYTHONPATH": str(self.package.parent)} | environment
        process = self.launcher.start(code, cwd=self.package.parent, env=variables)
        printed, _ = process.communicate()
        assert process.returncode == 0, printed
        *said, result = printed.splitlines()
        value, count = result.split()
        return (float(value), int(count)), said

    def files(self, pattern: str = "*.nb?") -> list[Path]:
        return sorted(self.cache.rglob(pattern))


@pytest.fixture(scope="module")
def launcher() -> Iterator[Launcher]:
    """Of processes that have numba, and have compiled something, and know nothing of a package."""
    with Launcher("numba") as launcher:
        yield launcher


@pytest.fixture
def tree(tmp_path: Path, launcher: Launcher) -> Tree:
    return Tree(tmp_path, launcher)


def test_the_second_process_takes_the_cache(tree: Tree) -> None:
    assert tree.run() == (COMPILED, [])
    assert tree.run() == (LOADED, [])
    of_called = CALL.replace("caller.stats", "called.stats").replace("caller(1.0)", "caller(1.0) * called(1.0)")
    assert tree.call(of_called) == (8.0, 0)


def test_an_edit_of_any_source_file_is_noticed(tree: Tree) -> None:
    tree.call()
    tree.edit("x + ADDED", "ADDED / (x - 1.0)")
    assert tree.call() == (math.inf, 1)
    (tree.package / "constants.py").write_text("LIMIT = 3.0\n")
    assert tree.call() == (math.inf, 1)
    assert tree.call() == (math.inf, 0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pattern", "damage"), [("*.nbi", "zeros"), ("*.nbc", "gone"), ("checksum", "empty"), ("*.nb?", "truncated")]
)
def test_what_is_damaged_is_compiled_again_and_mended(tree: Tree, pattern: str, damage: str) -> None:
    tree.call()
    assert tree.files(pattern)
    for path in tree.files(pattern):
        spoil(path, damage)
    assert tree.call() == COMPILED
    assert tree.call() == LOADED


def spoil(path: Path, damage: str) -> None:
    """Damage a file, or remove it."""
    content = path.read_bytes()
    third = len(content) // 3
    zeros = content[:third] + bytes(third + 1) + content[2 * third + 1 :]
    path.write_bytes({"truncated": content[:third], "zeros": zeros}.get(damage, b""))
    if damage == "gone":
        path.unlink()


def test_a_folder_that_cannot_be_written_is_said_and_survived(tree: Tree) -> None:
    tree.cache.touch()
    value, (said,) = tree.run()
    assert value[0] == 4.0
    assert "no cache in" in said


@pytest.mark.skipif(os.name != "posix", reason="rights of POSIX")
@pytest.mark.parametrize(("mode", "used"), [(0o777, False), (0o1777, True), (0o700, True)])
def test_a_place_where_another_user_can_put_files_is_not_used(tree: Tree, mode: int, used: bool) -> None:
    """In a shared temporary folder only the owner of a file removes it."""
    tree.cache.mkdir()
    tree.cache.chmod(mode)
    value, said = tree.run()
    assert (value[0], said == [], bool(tree.files())) == (4.0, used, used)


def test_without_numba_cache_dir_the_cache_is_in_the_users_own_directory(tree: Tree, tmp_path: Path) -> None:
    tree.call(NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(tmp_path / "own"), HOME=str(tmp_path / "own"))
    found = list((tmp_path / "own").rglob("*.nbc"))
    assert len(found) == 2
    assert not list(tree.package.rglob("*.nb?"))
    if os.name == "posix":
        assert (tmp_path / "own" / "mecp_env_functions").stat().st_mode & 0o022 == 0


@pytest.mark.slow
def test_folders_of_other_sources_are_removed_but_for_the_last_ones(tree: Tree) -> None:
    places, made = tree.cache / "mecp_env_functions", list[Path]()
    for n in range(KEPT + 3):
        tree.edit("x + ADDED", "x + ADDED + 0.0")
        tree.call()
        newest = max(places.iterdir(), key=lambda place: place.stat().st_mtime)
        os.utime(newest, (n, n))
        made.append(newest)
    assert [place.exists() for place in made] == [False] * 2 + [True] * (KEPT + 1)


def test_switched_off_the_functions_are_those_of_python(tree: Tree) -> None:
    code = IMPORT + "print(caller(1.0), int(hasattr(caller, 'stats')))"
    assert tree.call(code, NUMBA_DISABLE_JIT="1") == (4.0, 0)
    assert not tree.files()


FOREIGN = """
import numba
settings = lambda: {name: repr(getattr(numba.config, name)) for name in dir(numba.config) if name.isupper()}
before, half = settings(), numba.njit(lambda x: 0.5 * x)
import mecp_env.env
from mecp_env.core.se2 import wrap_angle
wrap_angle(0.0)
third = numba.njit(lambda x: x / 3)
assert settings() == before and (half(1.0), third(0.0)) == (0.5, 0.0)
try:
    numba.njit(lambda x: 1 // x)(0)
except ZeroDivisionError:
    print(*(function.stats.cache_path for function in (half, third)))
"""


def test_functions_of_others_are_left_alone() -> None:
    """Once the package changed the calls, the errors and the cache of every numba function of the process."""
    assert run_python(FOREIGN) == "None None\n"
