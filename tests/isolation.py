"""Where a test depends on the inside of the package: carriers that it builds itself, private names that it reads."""

import ast
from collections.abc import Iterator
from functools import cache

from tests.architecture import ROOT, sources

STAGES = ("slam", "planning", "episode")  # folders whose named tuples and frozen dataclasses are carriers, too
NAMED_TUPLES = ("_replace", "_asdict", "_fields")  # public in spite of their names, as `os._exit` is
MAKERS = "make.py"  # files that build carriers for the tests


@cache
def carriers() -> dict[str, set[str]]:
    """The folders of the package that define a carrier, by its name."""
    found: dict[str, set[str]] = {}
    for path, module in sources("mecp_env").items():
        folder = path.relative_to(ROOT).parts[1]
        for node in ast.walk(module):
            if isinstance(node, ast.ClassDef) and _is_carrier(node, folder in STAGES):
                found.setdefault(node.name, set()).add(folder)
    return found


def _is_carrier(node: ast.ClassDef, of_a_stage: bool) -> bool:
    decorators, bases = ([ast.unparse(part) for part in parts] for parts in (node.decorator_list, node.bases))
    frozen = "NamedTuple" in bases or any("frozen=True" in part for part in decorators)
    return "carrier" in decorators or node.name == "FeatureTable" or (of_a_stage and frozen)


def built(module: ast.Module) -> Iterator[str]:
    """The carriers that a file builds with arguments, once for each time."""
    imported = {  # real name and folders of the package, by each name; `mecp_env.slam` shows what is of `core`, too
        alias.asname or alias.name: (alias.name, {*(node.module or "").split(".")[1:2], "core"})
        for node in ast.walk(module)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mecp_env")
        for alias in node.names
    }
    for node in ast.walk(module):
        if isinstance(node, ast.Call) and (node.args or node.keywords):
            first, *rest = ast.unparse(node.func).split(".")
            name, folders = imported.get(first, ("", set()))
            name = rest[0] if len(rest) == 1 else name
            if len(rest) < 2 and folders & carriers().get(name, set()):
                yield name


def private(module: ast.Module) -> Iterator[str]:
    """The private names of others that a file reads: attributes, imports, and names that it patches."""
    for node in ast.walk(module):
        names = list[str]()
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls", "super()", "os"):
            names = [node.attr]
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("setattr", "getattr")):
            names = [str(part.value).split(".")[-1] for part in node.args if isinstance(part, ast.Constant)]
        yield from (name for name in names if name[:1] == "_" != name[1:2] and name not in NAMED_TUPLES)


def uses(what: str) -> dict[str, int]:
    """How many times each file of the tests builds carriers, or reads private names."""
    found = {"carriers": built, "private names": private}[what]
    files = {path: list(found(module)) for path, module in sources("tests").items() if path.name != MAKERS}
    return {path.relative_to(ROOT).as_posix(): len(names) for path, names in files.items() if names}
