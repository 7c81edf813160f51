"""The cache of compiled functions: unwritable, damaged, stale, switched off. Each case runs in its own process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import mecp_env
from mecp_env.core.jit_key import fingerprint
from mecp_env.core.se2 import inverse
from mecp_env.slam.messages import Cell
from tests.launcher import Launcher

PACKAGE = Path(mecp_env.__file__).parent
CALLED = (
    "from mecp_env.core.jit import compiled\n\nADDED = {added}\n\n\n"
    '@compiled\ndef called(x: float) -> float:\n    """{doc}"""\n    return x + ADDED\n'
)
CALLER = (
    "from mecp_env.core.jit import compiled\nfrom mecp_env.called import called\n\n\n"
    "@compiled\ndef caller(x: float) -> float:\n    return 2.0 * called(x)\n"
)
CALL = "from mecp_env.caller import caller; print(caller(1.0), caller(1.0))"  # twice the same number
COMPILING = "compiling functions"


class Tree:
    """A small package with two compiled functions, one calling the other, and a separate cache."""

    def __init__(self, folder: Path, launcher: Launcher) -> None:
        self.launcher = launcher
        self.package, self.cache = folder / "mecp_env", folder / "cache"
        (self.package / "core").mkdir(parents=True)
        for name in ("interrupts.py", "jit.py", "jit_cache.py", "jit_dispatcher.py", "jit_key.py", "warm_up_list.py"):
            shutil.copy(PACKAGE / "core" / name, self.package / "core")
        (self.package / "core" / "__init__.py").touch()
        (self.package / "__init__.py").touch()
        (self.package / "caller.py").write_text(CALLER)
        self.add(1.0)

    def add(self, added: float, doc: str = "x and some more.") -> None:
        """Change the constant or the docstring of the called function."""
        (self.package / "called.py").write_text(CALLED.format(added=added, doc=doc))

    def call(self, code: str = CALL, **environment: str) -> tuple[float, str]:
        """The result of caller(1.0) in a new process, and its stderr."""
        variables = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG"))}
        variables |= {"NUMBA_CACHE_DIR": str(self.cache), "PYTHONPATH": str(self.package.parent)}
        variables |= {"MECP_ENV_WARM_UP": "0"} | environment
        done = self.launcher.run(code, cwd=self.package.parent, env=variables)
        assert done.returncode == 0, done.stderr
        first, second = done.stdout.split()
        assert first == second
        return float(first), done.stderr

    def entries(self, suffix: str) -> list[Path]:
        return sorted(self.cache.rglob(f"*.{suffix}"))


@pytest.fixture(scope="module")
def launcher() -> Iterator[Launcher]:
    """Of processes that have numba, and have compiled something, and know nothing of a package."""
    with Launcher("numba") as launcher:
        yield launcher


@pytest.fixture
def tree(tmp_path: Path, launcher: Launcher) -> Tree:
    return Tree(tmp_path, launcher)


def test_first_compilation_says_so_in_one_line_and_the_second_process_takes_the_cache(tree: Tree) -> None:
    value, said = tree.call()
    assert value == 4.0
    assert said.count("\n") == 1
    assert COMPILING in said
    assert tree.call() == (4.0, "")


@pytest.mark.slow
def test_another_rule_in_a_called_kernel_in_another_file_is_noticed(tree: Tree) -> None:
    tree.call()
    called = tree.package / "called.py"
    called.write_text(called.read_text().replace("x + ADDED", "x - ADDED"))
    assert tree.call()[0] == 0.0


def test_a_constant_of_a_called_kernel_in_another_file_is_noticed(tree: Tree) -> None:
    assert tree.call()[0] == 4.0
    tree.add(2.0)
    value, said = tree.call()
    assert value == 6.0
    assert COMPILING in said


@pytest.mark.slow
def test_a_callee_is_part_of_its_callers_entry_and_python_can_call_it_too(tree: Tree) -> None:
    code = "from mecp_env.caller import caller, called; print(called(1.0), caller(1.0) - 2.0)"
    tree.call()
    assert len(tree.entries("nbc")) == 1
    assert tree.call(code)[0] == 2.0  # compiled for Python now
    assert len(tree.entries("nbc")) == 2
    assert tree.call(code) == (2.0, "")


@pytest.mark.slow
def test_what_was_compiled_as_a_part_of_its_caller_is_compiled_again_for_python(tree: Tree) -> None:
    code = "from mecp_env.caller import caller, called; caller(1.0); print(called(1.0), caller(1.0) - 2.0)"
    assert tree.call(code)[0] == 2.0
    assert tree.call(code) == (2.0, "")
    assert len(tree.entries("nbc")) == 2


@pytest.mark.slow
def test_what_was_loaded_is_linked_into_a_caller_that_is_compiled(tree: Tree) -> None:
    tree.call("from mecp_env.called import called; print(called(1.0), called(1.0))")
    code = "from mecp_env.caller import caller, called; print(called(1.0), caller(1.0) - 2.0)"
    value, said = tree.call(code)
    assert value == 2.0
    assert COMPILING in said
    assert tree.call(code) == (2.0, "")


@pytest.mark.slow
def test_numbers_that_are_written_in_calls_make_no_variants(tree: Tree) -> None:
    (tree.package / "caller.py").write_text(CALLER.replace("2.0 * called(x)", "x + called(1) + called(2)"))
    code = "from mecp_env.caller import caller, called; caller(1.0); print(len(called.signatures), 1)"
    assert tree.call(code)[0] == 1.0


def test_a_returned_array_costs_no_call_of_python() -> None:
    called = list[str]()
    sys.setprofile(lambda frame, event, _: called.append(frame.f_code.co_name) if event == "call" else None)
    try:
        array = inverse(np.zeros(3))
    finally:
        sys.setprofile(None)
    assert type(array) is np.ndarray
    assert "_numba_unpickle" not in called


@pytest.mark.slow
def test_a_function_on_the_list_has_an_entry_of_its_own(tree: Tree) -> None:
    (tree.package / "core" / "signatures.json").write_text('[["mecp_env.called", "called", ["float64"]]]')
    tree.call()
    assert len(tree.entries("nbc")) == 2


@pytest.mark.slow
def test_a_damaged_list_is_no_list(tree: Tree) -> None:
    (tree.package / "core" / "signatures.json").write_text("[[")
    assert tree.call()[0] == 4.0


@pytest.mark.slow
def test_an_error_in_a_callee_arrives(tree: Tree) -> None:
    called = tree.package / "called.py"
    raising = "if x < 2.0:\n        raise ValueError('small', x)\n    return x"
    called.write_text(called.read_text().replace("return x", raising))
    code = (
        "from mecp_env.caller import caller; import pytest\n"
        "with pytest.raises(ValueError, match='small.*1.5'): caller(1.5)\n"
        "print(caller(3.0), caller(3.0))"
    )
    for _ in range(2):  # compiled, and from the cache
        assert tree.call(code)[0] == 8.0


@pytest.mark.slow
def test_after_a_failed_compilation_the_next_one_is_kept(tree: Tree) -> None:
    code = (
        "from mecp_env.caller import caller; import numba, pytest\n"
        "with pytest.raises(numba.TypingError): caller('text')\n"
        "print(caller(1.0), caller(1.0))"
    )
    assert tree.call(code)[0] == 4.0
    assert len(tree.entries("nbc")) == 1


@pytest.mark.slow
def test_an_edit_of_words_compiles_nothing(tree: Tree) -> None:
    tree.call()
    tree.add(1.0, doc="One more than x.\n\n    Now in two lines.")
    assert tree.call() == (4.0, "")


@pytest.mark.parametrize(
    "damage", ["truncated", *(pytest.param(how, marks=pytest.mark.slow) for how in ("empty", "zeros"))]
)
def test_a_damaged_entry_is_compiled_again_and_mended(tree: Tree, damage: str) -> None:
    tree.call()
    for path in tree.entries("nbc"):
        content = path.read_bytes()
        third = len(content) // 3
        zeros = content[:third] + bytes(third) + content[2 * third :]
        path.write_bytes({"truncated": content[:third], "empty": b"", "zeros": zeros}[damage])
    assert tree.call()[0] == 4.0
    assert tree.call() == (4.0, "")


def test_an_unwritable_cache_is_said_and_survived(tree: Tree) -> None:
    value, said = tree.call(NUMBA_CACHE_DIR=os.devnull + "/nowhere")
    assert value == 4.0
    assert "nowhere" in said
    assert COMPILING in said


@pytest.mark.slow
def test_without_numba_cache_dir_the_cache_lies_in_the_users_own_directory(tree: Tree, tmp_path: Path) -> None:
    tree.call(NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(tmp_path / "own"), HOME=str(tmp_path / "own"))
    found = list((tmp_path / "own").rglob("*.nbc"))
    assert len(found) == 1  # the called function is part of its caller's entry
    assert not list(tree.package.rglob("*.nb?"))
    if os.name == "posix":
        assert found[0].parent.stat().st_mode & 0o077 == 0


@pytest.mark.slow
def test_entries_of_long_ago_are_removed_when_something_is_compiled(tree: Tree) -> None:
    tree.call()
    old = tree.entries("nbc")
    for path in old:
        os.utime(path, (0, 0))
    tree.add(3.0)
    tree.call()
    assert not any(path.exists() for path in old)


def test_jit_can_be_switched_off(tree: Tree) -> None:
    assert tree.call(NUMBA_DISABLE_JIT="1") == (4.0, "")
    assert not tree.entries("nbc")


def test_the_key_is_the_same_in_every_process_and_knows_what_a_kernel_uses() -> None:
    code = (
        "from mecp_env.core.jit_key import fingerprint; from mecp_env.core.linalg import downdate\n"
        "print(fingerprint(downdate.py_func))"
    )
    keys = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": str(PACKAGE.parent)},
            capture_output=True,
            text=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(keys) == 1
    assert len(keys.pop().strip()) == 16


def test_the_key_follows_values_that_a_function_reads() -> None:
    def key(scale: object) -> str:
        return fingerprint(lambda x: x * scale)

    values = [1, 1.0, 2.0, (1, 2), np.array([1.0]), np.array([2.0]), Cell, Cell.FREE, frozenset({"a", "b"})]
    assert len({key(value) for value in values}) == len(values)
    assert key(np.array([2.0])) == key(np.array([2.0]))


@pytest.mark.slow
def test_an_entry_that_another_argument_type_left_under_the_same_name_is_not_used(tree: Tree) -> None:
    tree.call()
    (entry,) = tree.entries("nbc")
    whole = "from mecp_env.caller import caller; print(caller(1), caller(1))"
    assert tree.call(whole)[0] == 4.0
    (other,) = set(tree.entries("nbc")) - {entry}
    shutil.copy(entry, other)
    assert tree.call(whole)[0] == 4.0


@pytest.mark.slow
def test_without_the_internals_plain_caching_notices_a_change_in_another_file(tree: Tree) -> None:
    (tree.package / "core" / "jit_cache.py").write_text("raise ImportError\n")
    assert tree.call() == (4.0, "")
    assert tree.entries("nbi")
    tree.add(2.0)
    assert tree.call() == (6.0, "")
    assert tree.call(NUMBA_CACHE_DIR=os.devnull + "/nowhere")[0] == 6.0


@pytest.mark.slow
def test_two_processes_on_a_cold_cache_get_the_same_result(tree: Tree) -> None:
    with ThreadPoolExecutor(2) as pool:
        values = [value for value, _ in pool.map(lambda _: tree.call(), range(2))]
    assert values == [4.0, 4.0]
    assert tree.call() == (4.0, "")


@pytest.mark.slow
def test_a_read_only_cache_serves_what_it_has(tree: Tree) -> None:
    """A folder that root may still write to is filled; one that takes no files is read."""
    tree.call()
    code = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); " + CALL  # every write fails
    assert tree.call(code, PYTHONWARNINGS="ignore")[0] == 4.0


def test_a_full_disk_costs_the_entry_only(tree: Tree) -> None:
    """Every write of more than 100 bytes fails, as on a full disk."""
    limit = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    limit += "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); "
    assert tree.call(limit + CALL)[0] == 4.0
    assert not tree.entries("nbc")
    assert not tree.entries("nbc.tmp.*")
    assert tree.call()[0] == 4.0
