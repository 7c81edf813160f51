"""The shape of the source tree in figures, which test_architecture.py bounds: `python -m tests.architecture`."""

import ast
import io
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "mecp_env"
TREES = ("mecp_env", "agents", "benchmarks")
COMPILED = {"compiled", "inner"}  # names of the decorators of compiled functions
BRANCHES = (ast.If, ast.For, ast.While, ast.IfExp, ast.ExceptHandler, ast.BoolOp, ast.comprehension, ast.match_case)
NO_CODE = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER, tokenize.COMMENT}


@dataclass(frozen=True)
class Function:
    """A function of the tree."""

    where: str
    compiled: bool
    arguments: int
    complexity: int


@cache
def sources(tree: str) -> dict[Path, ast.Module]:
    """The syntax tree of each file below a folder of the clone."""
    return {path: ast.parse(path.read_text()) for path in sorted((ROOT / tree).rglob("*.py"))}


@cache
def functions(tree: str) -> tuple[Function, ...]:
    """All functions and methods below a folder."""
    nodes = [
        (path, node)
        for path, module in sources(tree).items()
        for node in ast.walk(module)
        if isinstance(node, ast.FunctionDef)
    ]
    return tuple(_function(f"{path.relative_to(ROOT)}:{node.lineno} {node.name}", node) for path, node in nodes)


def _function(where: str, node: ast.FunctionDef) -> Function:
    arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
    count = sum(argument.arg not in ("self", "cls") for argument in arguments)
    return Function(where, is_compiled(node), count, 1 + sum(isinstance(part, BRANCHES) for part in ast.walk(node)))


def is_compiled(node: ast.stmt) -> bool:
    """True for a compiled function."""
    decorators = node.decorator_list if isinstance(node, ast.FunctionDef) else []
    return bool({ast.unparse(decorator).partition("(")[0] for decorator in decorators} & COMPILED)


def imports(tree: str, of_folders: bool = False) -> dict[str, set[str]]:
    """For each module of a package the others that it imports, inside functions too; or so for what is at its root."""
    graph = grimp.build_graph(tree, cache_dir=None)
    for name in graph.find_children(tree) if of_folders else ():
        graph.squash_module(name)
    return {name: graph.find_modules_directly_imported_by(name) - {name} for name in graph.modules}


def levels(graph: dict[str, set[str]]) -> int:
    """The longest chain of imports; raises `ValueError` that names a cycle."""
    depth: dict[str, int] = {}
    for name in TopologicalSorter(graph).static_order():
        depth[name] = 1 + max((depth[other] for other in graph[name]), default=0)
    return max(depth.values())


def files_to_change(module: str, below: str) -> int:
    """How many files of a package one reads to change a module: it and those it imports, but for compiled functions."""
    graph = grimp.build_graph("mecp_env", cache_dir=None)
    names = {module, *(name for name in graph.find_upstream_modules(module) if name.startswith(below))}
    files = [sources("mecp_env").get(ROOT / f"{name.replace('.', '/')}.py", ast.Module([], [])) for name in names]
    found = [[is_compiled(node) for node in file.body if isinstance(node, ast.FunctionDef)] for file in files]
    return sum(not compiled or not all(compiled) for compiled in found)


def code_lines(path: Path) -> int:
    """Lines of a file without blanks, comments and docstrings."""
    text, lines = path.read_text(), set[int]()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(sources(path.relative_to(ROOT).parts[0])[path]):
        documented = (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None
        )
        if documented:
            lines.difference_update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def tunable_numbers() -> list[str]:
    """The numbers by which the estimator can be tuned: number fields of its configuration, and constants of modules.

    A constant counts when its value is a float, or an int other than the codes -2..2, or a tuple of such (each counts);
    ranges, shifts of a whole word, and numbers that are the code of something (`range(7)`) do not.
    """
    found = []
    for path, module in sources("mecp_env").items():
        inside = path.relative_to(PACKAGE).parts
        if inside[0] != "slam":
            continue
        for node in module.body:
            if path.name == "config.py" and isinstance(node, ast.ClassDef):
                found += [f"{node.name}.{name}" for name in _number_fields(node)]
            elif path.name != "config.py" and isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                found += [f"{'/'.join(inside)}: {name}" for name in _number_constants(node)]
    return found


def _number_fields(node: ast.ClassDef) -> Iterator[str]:
    for field in node.body:
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            kind = ast.unparse(field.annotation)
            if kind.startswith(("int", "float", "Limits", "tuple")):
                yield field.target.id


def _number_constants(node: ast.Assign | ast.AnnAssign) -> Iterator[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
    if not all(name.isupper() or "_" in name for name in names) or not names[0].isupper():
        return
    assert node.value is not None
    values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
    shared = names * len(values) if len(names) == 1 else names
    yield from (name for name, value in zip(shared, values, strict=False) if _is_tunable(value))


def _is_tunable(value: ast.expr) -> bool:
    if isinstance(value, ast.Call):
        return ast.unparse(value.func) in ("math.radians", "np.radians", "np.deg2rad")
    if isinstance(value, ast.UnaryOp):
        return _is_tunable(value.operand)
    return isinstance(value, ast.Constant) and (
        isinstance(value.value, float) or (isinstance(value.value, int) and value.value not in (True, False, 0, 1, 2))
    )


@cache
def figures() -> dict[str, int]:
    """The figures of the architecture."""
    compiled = [function for function in functions("mecp_env") if function.compiled]
    return {
        "files at the root": len(list(PACKAGE.glob("*.py"))),
        "import levels": levels(imports("mecp_env", of_folders=True)),
        "compiled functions": len(compiled),
        "compiled functions with more than 8 arguments": sum(function.arguments > 8 for function in compiled),
        "tunable numbers of the estimator": len(tunable_numbers()),
        "code lines of slam/pipeline.py": code_lines(PACKAGE / "slam" / "pipeline.py"),
        "files to change corner extraction": files_to_change("mecp_env.slam.frontend.corners", "mecp_env.slam"),
    }


if __name__ == "__main__":
    trees = {f"code lines of {tree}": sum(map(code_lines, sources(tree))) for tree in (*TREES, "tests")}
    for what, number in (figures() | trees).items():
        print(f"{number:6}  {what}")
