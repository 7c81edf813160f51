"""Where a test depends on the inside of the package: carriers that it builds, private names that it reads."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache

from tests.architecture import ROOT, module_name, sources

STAGES = tuple(f"mecp_env.{folder}." for folder in ("slam", "planning", "episode"))
PUBLIC = ("_replace", "_asdict", "_fields", "_exit")  # of named tuples and of `os`


@cache
def carriers() -> frozenset[str]:
    """Classes that stages pass on: what is decorated as a carrier; named tuples and frozen dataclasses of stages."""
    return frozenset(
        node.name
        for path, module in sources("mecp_env").items()
        for node in ast.walk(module)
        if isinstance(node, ast.ClassDef) and _is_carrier(node, module_name(path).startswith(STAGES))
    )


def _is_carrier(node: ast.ClassDef, of_a_stage: bool) -> bool:
    decorators = [ast.unparse(part) for part in node.decorator_list]
    frozen = any("frozen=True" in part for part in decorators) or "NamedTuple" in map(ast.unparse, node.bases)
    return "carrier" in decorators or node.name == "FeatureTable" or (of_a_stage and frozen)


def built(module: ast.Module) -> Iterator[str]:
    """The carriers that a file builds with arguments, by the names that it imports."""
    imported, modules = _imported(module)
    for node in ast.walk(module):
        if isinstance(node, ast.Call) and (node.args or node.keywords):
            of_module = isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) in modules
            name = node.func.attr if of_module else getattr(node.func, "id", "")
            if (of_module or name in imported) and name in carriers():
                yield name


def private(module: ast.Module) -> Iterator[str]:
    """The private names that a file reads of others: attributes, imports, and names that it patches."""
    for node in ast.walk(module):
        names = list[str]()
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls", "super()"):
            names = [node.attr]
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("setattr", "getattr")):
            names = [part.value for part in node.args if isinstance(part, ast.Constant) and isinstance(part.value, str)]
        yield from (name for name in names if name[:1] == "_" != name[1:2] and name not in PUBLIC)


def _imported(module: ast.Module) -> tuple[set[str], set[str]]:
    """The names that a file imports from the package, and those that are modules."""
    names = [
        (alias.asname or alias.name, f"{node.module}.{alias.name}")
        for node in ast.walk(module)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mecp_env")
        for alias in node.names
    ]
    modules = {module_name(path) for path in sources("mecp_env")}
    return {name for name, _ in names}, {name for name, full in names if full in modules}


def counts(what: str) -> dict[str, int]:
    """How many carriers, or private names, each file of the tests has, builders left out."""
    found = {"carriers": built, "private names": private}[what]
    files = {path: module for path, module in sources("tests").items() if path.name != "make.py"}
    numbers = {str(path.relative_to(ROOT / "tests")): len(list(found(module))) for path, module in files.items()}
    return {file: number for file, number in numbers.items() if number}
