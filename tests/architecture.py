"""The shape of the source tree in figures, which test_architecture.py bounds."""

import ast
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
CODES = (True, False, 0, 1, 2)  # numbers that are no tuning


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


def statements(path: Path) -> int:
    """The statements of a file, docstrings included."""
    return sum(isinstance(node, ast.stmt) for node in ast.walk(ast.parse(path.read_text())))


def tunable_numbers() -> int:
    """The numbers by which the estimator can be tuned: number fields of its configuration, and constants of modules."""
    files = {path: module for path, module in sources("mecp_env").items() if PACKAGE / "slam" in path.parents}
    fields = [
        field.annotation
        for path, module in files.items()
        for node in ast.walk(module)
        if path.name == "config.py" and isinstance(node, ast.ClassDef)
        for field in node.body
        if isinstance(field, ast.AnnAssign)
    ]
    constants = [
        number.value
        for path, module in files.items()
        for node in module.body
        if path.name != "config.py" and isinstance(node, ast.Assign) and ast.unparse(node.targets[0])[:1].isupper()
        for number in getattr(node.value, "elts", [node.value])
        if isinstance(number, ast.Constant) and isinstance(number.value, int | float)
    ]
    of_numbers = [kind for kind in fields if ast.unparse(kind).startswith(("int", "float", "Limits", "tuple"))]
    return len(of_numbers) + len([value for value in constants if isinstance(value, float) or value not in CODES])


@cache
def figures() -> dict[str, int]:
    """The figures of the architecture."""
    compiled = [function for function in functions("mecp_env") if function.compiled]
    return {
        "files at the root": len(list(PACKAGE.glob("*.py"))),
        "import levels": levels(imports("mecp_env", of_folders=True)),
        "compiled functions": len(compiled),
        "compiled functions with more than 8 arguments": sum(function.arguments > 8 for function in compiled),
        "tunable numbers of the estimator": tunable_numbers(),
        "statements of slam/pipeline.py": statements(PACKAGE / "slam" / "pipeline.py"),
        "files to change corner extraction": files_to_change("mecp_env.slam.frontend.corners", "mecp_env.slam"),
    }
