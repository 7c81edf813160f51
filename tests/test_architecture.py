"""The rules of the source tree: few files at the root, no import cycles, bounded functions (CONTRIBUTING.md)."""

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

from mecp_env.core.jit import NOT_COMPILED

ROOT = Path(__file__).parent.parent
TREES = ("mecp_env", "agents", "benchmarks")
BRANCHES = (ast.If, ast.For, ast.While, ast.IfExp, ast.ExceptHandler, ast.BoolOp, ast.comprehension, ast.match_case)
NO_CODE = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER, tokenize.COMMENT}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
MOST = {
    "files at the root": 6,
    "import levels": 11,
    "files to change corner extraction": 3,
    "code lines of slam/pipeline.py": 136,
    "compiled functions": 289,
}
INSIDE = {  # how often a file of the tests reads private names of others; may only become less
    "tests/benchmarks/test_kiss.py": 1,
    "tests/benchmarks/test_stock_ppo.py": 4,  # of multiprocessing
    "tests/conftest.py": 1,
    "tests/env/helpers.py": 2,
    "tests/env/test_goal_actions.py": 1,
    "tests/policies/test_evaluate.py": 1,
    "tests/slam/panorama/test_registration.py": 1,
    "tests/world/rays.py": 1,
}
PUBLIC = ("_replace", "_asdict", "_fields")  # in spite of their names


@cache
def sources(tree: str) -> dict[str, ast.Module]:
    """The syntax tree of each module below a folder of the clone, by its dotted name."""
    paths = sorted((ROOT / tree).rglob("*.py"))
    names = (".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in paths)
    return {name: ast.parse(path.read_text()) for name, path in zip(names, paths, strict=True)}


def functions(tree: str) -> Iterator[tuple[str, bool, int, int]]:
    """Of each function below a folder the module and name, whether it is compiled, its arguments, its complexity."""
    for name, module in sources(tree).items():
        for node in ast.walk(module):
            if isinstance(node, DEFINITIONS):
                arguments = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                complexity = 1 + sum(isinstance(part, BRANCHES) for part in ast.walk(node))
                yield f"{name} {node.name}", is_compiled(node), len({*arguments} - {"self", "cls"}), complexity


def is_compiled(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any(ast.unparse(decorator).partition("(")[0] in ("compiled", "inner") for decorator in node.decorator_list)


@cache
def imports(tree: str) -> dict[str, set[str]]:
    """For each module below a folder the modules of the same folder that it imports, inside functions too."""
    known = sources(tree)
    return {name: {found for found in imported(module, {*known}) if found != name} for name, module in known.items()}


def imported(module: ast.Module, known: set[str]) -> Iterator[str]:
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from {alias.name for alias in node.names} & known
        elif isinstance(node, ast.ImportFrom) and node.module:
            full = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from {name if name in known else node.module for name in full} & known


def levels(graph: dict[str, set[str]]) -> int:
    """The longest chain of imports; raises `ValueError` that names a cycle."""
    depth: dict[str, int] = {}

    def visit(name: str, above: tuple[str, ...]) -> int:
        if name in above:
            raise ValueError(f"import cycle: {' -> '.join((*above[above.index(name) :], name))}")
        if name not in depth:
            depth[name] = 1 + max((visit(other, (*above, name)) for other in sorted(graph.get(name, ()))), default=0)
        return depth[name]

    return max(visit(name, ()) for name in sorted(graph))


def folders() -> dict[str, set[str]]:
    """The import graph of what is at the root of the package: its files and folders."""
    graph: dict[str, set[str]] = {}
    for name, found in imports("mecp_env").items():
        top = ".".join(name.split(".")[:2])
        graph[top] = graph.get(top, set()) | {".".join(other.split(".")[:2]) for other in found} - {top}
    return graph


def files_of_corners() -> int:
    """The files below `slam` that extracting corners takes, but for those that are compiled throughout."""
    found, todo = set[str](), ["mecp_env.slam.frontend.corners"]
    while todo:
        name = todo.pop()
        if name not in found and name.startswith("mecp_env.slam"):
            found.add(name)
            todo.extend(imports("mecp_env")[name])
    nodes = {name: [n for n in sources("mecp_env")[name].body if isinstance(n, DEFINITIONS)] for name in found}
    return sum(not (defined and all(map(is_compiled, defined))) for defined in nodes.values())


def lines_of_pipeline() -> int:
    """Lines of the pipeline without blanks, comments and docstrings."""
    text, lines = (ROOT / "mecp_env/slam/pipeline.py").read_text(), set[int]()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            lines.difference_update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


FIGURES = {
    "files at the root": lambda: len([*(ROOT / "mecp_env").glob("*.py")]),
    "import levels": lambda: levels(folders()),
    "compiled functions": lambda: sum(compiled for _, compiled, _, _ in functions("mecp_env")),
    "code lines of slam/pipeline.py": lines_of_pipeline,
    "files to change corner extraction": files_of_corners,
}


@pytest.mark.parametrize("what", MOST)
def test_the_tree_keeps_its_bounds(what: str) -> None:
    assert FIGURES[what]() <= MOST[what]


def test_folders_that_are_not_compiled_have_no_compiled_functions() -> None:
    """An edit there compiles nothing again; that nothing else imports them is a contract of the import linter."""
    compiled = [where for where, is_compiled, _, _ in functions("mecp_env") if is_compiled]
    assert compiled
    assert not [where for where in compiled if where.split(".")[1] in NOT_COMPILED]


@pytest.mark.parametrize("tree", TREES)
def test_no_import_cycles(tree: str) -> None:
    assert levels(imports(tree)) >= 1  # raises ValueError that names the cycle


def test_functions_are_small() -> None:
    most = {True: (8, 20), False: (6, 8)}  # arguments and complexity of compiled functions, and of all others
    every = chain(functions("mecp_env"), functions("agents"))
    assert not [
        f"{where}: {n}, {c}" for where, compiled, n, c in every if n > most[compiled][0] or c > most[compiled][1]
    ]


def private(module: ast.Module) -> Iterator[str]:
    """The private names of others that a file reads: attributes, imports, and names that it patches."""
    for node in ast.walk(module):
        names = list[str]()
        if isinstance(node, ast.Attribute):
            whose = getattr(node.value, "func", node.value)
            own = getattr(whose, "id", "") in ("self", "cls", "os", "super")
            names = [] if own else [node.attr]
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("setattr", "getattr")):
            names = [str(part.value).split(".")[-1] for part in node.args if isinstance(part, ast.Constant)]
        yield from (name for name in names if name[:1] == "_" != name[1:2] and name not in PUBLIC)


def test_tests_stay_outside() -> None:
    found = Counter({name: len([*private(module)]) for name, module in sources("tests").items()})
    assert {name.replace(".", "/") + ".py": count for name, count in found.items() if count} == INSIDE
