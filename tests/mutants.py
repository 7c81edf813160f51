"""Mutants of the estimator that its tests do not notice: `python -m tests.mutants --count 200`.

Each mutant changes one rule of a function below `mecp_env/slam`: a comparison, a connective, a sign, a constant, a
condition. It is written into a copy of the tree, where the tests of its folder run, and then those of the pipeline, up
to the first that fails. Functions stay compiled: those that call the mutated one are compiled again, all others come
from a cache. Results are kept in a folder, so that the same command continues after a kill.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
PLACE = ROOT / "runs/mutants"
ESTIMATOR, TESTS = Path("mecp_env/slam"), Path("tests/slam")
BESIDE = *sorted(str(path.relative_to(ROOT)) for path in (ROOT / TESTS).glob("test_*.py")), f"{TESTS}/localisation"
WHOLE = (
    "every_noise_gives_a_right_map",
    "each_landmark_is_a_corner_of_its_own",
    "polygons_of_different_rooms_share_no_vertex",
    "most_scans_recognise_a_polygon_once_the_room_is_known",
    "the_robots_room_is_the_true_one_away_from_the_door",
    "landmarks_lie_in_the_room_of_their_corner",
    "visible_landmarks_are_the_vertices_of_the_polygons_around_a_point",
    "every_decision_has_its_reason",
)  # on few drives
SLOW = (TESTS / "filters/test_consistency.py",)  # NEES of many drives
LIMIT_S = 300
PAD = 1000  # bytes behind each file of the copy: a mutant is as long as the original, or else numba compiles all of it

Node = ast.expr | ast.stmt
Change = tuple[Node, Node]  # what is there, and what may stand in its place
NEGATED = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.In: ast.NotIn, ast.Is: ast.IsNot}
NEGATED |= {there: here for here, there in NEGATED.items()}
WITH_EQUAL = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
SIGNS = {ast.Add: ast.Sub, ast.Sub: ast.Add}
EXTREMES = {"min": "max", "max": "min"}
SHAPES = {"empty", "zeros", "ones", "full", "reshape", "axis", "dtype", "ndmin"}  # whose numbers are no rules
NUMBERS = (ast.BinOp, ast.AugAssign, ast.Constant)
SILENT = (ast.Raise, ast.Assert, ast.JoinedStr)  # what only says something


@dataclass(frozen=True)
class Mutant:
    """The bytes from `start` to `end` of a file, and `text` in their place."""

    name: str
    file: str
    line: int
    function: str
    start: int
    end: int
    text: bytes
    rule: bool  # a comparison, a connective or a condition; else a number


def mutants(root: Path) -> Iterator[Mutant]:
    """All mutants of the estimator's functions."""
    for path in sorted((root / ESTIMATOR).rglob("*.py")):
        text = path.read_bytes()
        starts = [0]
        for line in text.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        for function in ast.walk(ast.parse(text)):
            if isinstance(function, ast.FunctionDef):
                for node, changed in (pair for part in function.body for pair in changes(part)):
                    start, end = (starts[row - 1] + column for row, column in spans(node))
                    place = str(path.relative_to(root)), node.lineno, function.name
                    before, after = ast.unparse(node), ast.unparse(changed)
                    name = "{}:{} {}: {} -> {}".format(*place, before, after)
                    if isinstance(node, ast.expr):  # as many lines, or else numba compiles what follows
                        after = "(" + after + "\n" * text.count(b"\n", start, end) + ")"
                    rule = not isinstance(changed, NUMBERS) or ast.unparse(changed) in ("True", "False")
                    yield Mutant(name, *place, start, end, after.encode(), rule)


def spans(node: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    """Row and column where a node begins and ends."""
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)


def changes(node: ast.AST) -> Iterator[Change]:
    """Nodes at and below `node`, each with what may stand in its place."""
    if isinstance(node, (*SILENT, ast.FunctionDef)):
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield from ((node, changed) for changed in changed_rules(node))
    yield from conditions(node)
    names = {getattr(node, "arg", ""), getattr(getattr(node, "func", None), "attr", "")}
    for name, below in ast.iter_fields(node):
        if name in ("annotation", "slice", "op", "ops") or names & SHAPES:
            continue
        for inner in below if isinstance(below, list) else [below]:
            if isinstance(inner, ast.AST):
                yield from changes(inner)


def conditions(node: ast.AST) -> Iterator[Change]:
    """The conditions of a node, each with True and False."""
    tests = [node.test] if isinstance(node, ast.If | ast.IfExp) else getattr(node, "ifs", [])
    yield from ((test, ast.Constant(value)) for test in tests for value in (True, False))


def changed_rules(node: ast.AST) -> Iterator[Node]:
    """What may stand in the place of an expression."""
    match node:
        case ast.Compare():
            for k, op in enumerate(node.ops):
                counts = any(isinstance(side, ast.Constant | ast.Call) for side in (node.left, *node.comparators))
                for table in (NEGATED, WITH_EQUAL) if counts and "." not in ast.unparse(node) else (NEGATED,):
                    if type(op) in table:
                        yield ast.Compare(
                            node.left, [*node.ops[:k], table[type(op)](), *node.ops[k + 1 :]], node.comparators
                        )
        case ast.BoolOp():
            yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
            for k in range(len(node.values)):
                yield (
                    ast.BoolOp(node.op, node.values[:k] + node.values[k + 1 :])
                    if len(node.values) > 2
                    else node.values[1 - k]
                )
        case ast.UnaryOp(op=ast.Not()):
            yield node.operand
        case ast.BinOp() if type(node.op) in SIGNS and not isinstance(node.left, ast.List | ast.Tuple | ast.Starred):
            yield ast.BinOp(node.left, SIGNS[type(node.op)](), node.right)
        case ast.AugAssign() if type(node.op) in SIGNS:
            yield ast.AugAssign(node.target, SIGNS[type(node.op)](), node.value)
        case ast.Call(func=ast.Name(id=name)) if name in EXTREMES and len(node.args) > 1:
            yield ast.Call(ast.Name(EXTREMES[name]), node.args, node.keywords)
        case ast.Constant(value=float(value)) if not 0.0 < value < 1e-4:
            yield ast.Constant(2.0 * value or 1.0)


def drawn(root: Path, seed: int) -> list[Mutant]:
    """The mutants in random order, one of each line; those of a rule five times as likely as those of a number."""
    rng, chosen = random.Random(seed), dict[tuple[str, int], Mutant]()
    weighed = [(rng.random() ** (1.0 / (1.0 + 4.0 * mutant.rule)), mutant) for mutant in mutants(root)]
    for _, mutant in sorted(weighed, key=itemgetter(0), reverse=True):
        chosen.setdefault((mutant.file, mutant.line), mutant)
    return list(chosen.values())


def copy_tree(place: Path) -> None:
    """Write the tracked and new files there; each module has `PAD` bytes behind it, and its old time."""
    listed = ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, capture_output=True, text=True, check=True).stdout.split("\0"):
        source, copied = ROOT / name, place / name
        if source.is_file():
            copied.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, copied)
            if copied.suffix == ".py":
                write(copied, source.read_bytes(), source.stat().st_mtime_ns)


def write(path: Path, text: bytes, time_ns: int) -> None:
    """Write a module with as many bytes, and the time, as another of `text`; Python's own cache would not notice."""
    size = (ROOT / path.relative_to(PLACE / "tree")).stat().st_size + PAD
    path.write_bytes(text + b"\n" * (size - len(text)))
    os.utime(path, ns=(time_ns, time_ns))
    for kept in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        kept.unlink()


@cache
def names_used() -> dict[str, set[str]]:
    """By the name of each compiled function, the names in it."""
    used = defaultdict[str, set[str]](set)
    for path in (ROOT / "mecp_env").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.FunctionDef) and any(ast.unparse(d) == "compiled" for d in node.decorator_list):
                used[node.name] |= {getattr(n, "id", getattr(n, "attr", "")) for n in ast.walk(node)}
    return used


def affected(name: str) -> list[str]:
    """Names of the compiled functions that are `name` or call it, or another that calls it."""
    used, found, before = names_used(), {name}, set[str]()
    while found != before:
        before = found
        found = found | {caller for caller, names in used.items() if names & found}
    return sorted(found & used.keys())


def tests_of(file: str) -> tuple[str, ...]:
    """The tests of a file: those of its folder, or beside the folders; then a few of the pipeline."""
    folder = TESTS / Path(file).relative_to(ESTIMATOR).parent
    own = BESIDE if folder == TESTS else (str(folder),)
    return *own, *(f"{TESTS}/test_pipeline.py::test_{name}" for name in WHOLE)


def outcome(tree: Path, tests: Iterable[str], names: Iterable[str], limit_s: float | None = LIMIT_S) -> tuple[str, str]:
    """killed, survived or timed out, and the test that failed; `names`: functions to compile again."""
    shutil.rmtree(tree.parent / "functions/fresh", ignore_errors=True)
    code = f"import sys; from tests.mutants import run_tests; sys.exit(run_tests({[*names]!r}, {[*tests]!r}))"
    try:
        done = subprocess.run([sys.executable, "-c", code], cwd=tree, capture_output=True, text=True, timeout=limit_s)
    except subprocess.TimeoutExpired:
        return "timed out", ""
    lines = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return ("killed" if done.returncode else "survived"), " ".join(lines)[:200]


def run_tests(names: list[str], tests: list[str]) -> int:
    """Exit code of pytest in this process; the named functions are compiled, others come from the cache."""
    from mecp_env.core import jit

    compiled, place = jit.compiled, Path.cwd().parent / "functions"

    def sorted_out(function: Any) -> Any:
        jit.cache_directory = lambda: place / ("fresh" if function.__name__ in names else "kept")
        return compiled(function)

    jit.compiled = sorted_out
    left_out = [f"--ignore={path}" for path in SLOW]
    rules = ["-x", "-q", "-n0", "-m", "not slow", "-p", "no:cacheprovider", "--hypothesis-seed=0", *left_out]
    return pytest.main([*rules, *tests])


def try_out(mutant: Mutant, tree: Path) -> tuple[str, str]:
    """How a mutant ends, and the test that failed."""
    path, source = tree / mutant.file, ROOT / mutant.file
    text, time_ns = source.read_bytes(), source.stat().st_mtime_ns
    write(path, text[: mutant.start] + mutant.text + text[mutant.end :], time_ns)
    try:
        return outcome(tree, tests_of(mutant.file), affected(mutant.function))
    finally:
        write(path, text, time_ns)


def keep(path: Path, results: dict[str, dict[str, str]], name: str, end: str, test: str) -> None:
    """Add a result, and print it."""
    results[name] = {"mutant": name, "end": end, "test": test}
    with path.open("a") as file:
        file.write(json.dumps(results[name]) + "\n")
    print(f"{end:9}  {name}  {test}", flush=True)


def main() -> int:
    """Exit code of the command."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--count", type=int, default=200, help="how many, of all in random order")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="run again all mutants whose description contains this")
    given = parser.parse_args()
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", "PYTHONPATH": ""}
    kept, tree = PLACE / f"seed-{given.seed}.jsonl", PLACE / "tree"
    copy_tree(tree)
    results = {one["mutant"]: one for one in map(json.loads, kept.read_text().splitlines())} if kept.exists() else {}
    chosen = [one for one in drawn(ROOT, given.seed) if given.only in one.name]
    chosen, sound = chosen if given.only else chosen[: given.count], set[str]()
    for mutant in chosen:
        tests = tests_of(mutant.file)
        if given.only or mutant.name not in results:
            if tests[0] not in sound:  # compiles all functions, too
                keep(kept, results, tests[0], *outcome(tree, tests, (), None))
                sound.add(tests[0])
                if results[tests[0]]["end"] != "survived":
                    raise SystemExit(f"without a mutant: {results[tests[0]]}")
            keep(kept, results, mutant.name, *try_out(mutant, tree))
    ends = [(one.file, results[one.name]["end"]) for one in chosen]
    for folder, end in sorted(Counter((str(Path(file).parent), end) for file, end in ends).items()):
        print(*folder, end)
    print(Counter(end for _, end in ends))
    return 0


if __name__ == "__main__":
    sys.exit(main())
