"""The shape of the source tree in figures, which test_architecture.py bounds: `python -m tests.architecture`."""

import ast
import io
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "mecp_env"
TREES = ("mecp_env", "agents", "benchmarks")
COMPILED = ("compiled", "inner")  # names of the decorators of compiled functions
BRANCHES = (ast.If, ast.For, ast.While, ast.IfExp, ast.ExceptHandler, ast.BoolOp, ast.comprehension, ast.match_case)
NO_CODE = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER, tokenize.COMMENT}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


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
    return tuple(_functions(tree))


def _functions(tree: str) -> Iterator[Function]:
    for path, module in sources(tree).items():
        for node in ast.walk(module):
            if isinstance(node, DEFINITIONS):
                names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                decorators = {
                    getattr(d, "id", getattr(getattr(d, "func", None), "id", "")) for d in node.decorator_list
                }
                yield Function(
                    f"{path.relative_to(ROOT)}:{node.lineno} {node.name}",
                    bool(decorators & set(COMPILED)),
                    len([name for name in names if name not in ("self", "cls")]),
                    1 + sum(isinstance(part, BRANCHES) for part in ast.walk(node)),
                )


def root_files() -> list[str]:
    """The Python files at the root of the package."""
    return sorted(path.name for path in PACKAGE.glob("*.py"))


def module_name(path: Path) -> str:
    """The dotted name of a file."""
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    return name.removesuffix(".__init__")


@cache
def imports(tree: str) -> dict[str, set[str]]:
    """For each module below a folder the modules of the same folder that it imports, inside functions too."""
    known = {module_name(path): module for path, module in sources(tree).items()}
    return {name: {found for found in _imported(module, known) if found != name} for name, module in known.items()}


def _imported(module: ast.Module, known: dict[str, ast.Module]) -> Iterator[str]:
    for node in ast.walk(module):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield from [name for name in (full if full in known else node.module,) if name in known]


@cache
def folders(tree: str) -> dict[str, set[str]]:
    """The import graph of what is at the root of a package: its files and folders."""
    graph: dict[str, set[str]] = {}
    for name, found in imports(tree).items():
        top = ".".join(name.split(".")[:2])
        graph.setdefault(top, set()).update(".".join(other.split(".")[:2]) for other in found)
        graph[top].discard(top)
    return graph


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


def reached(tree: str, start: str, below: str) -> set[str]:
    """The modules below `below` that `start` imports, itself and what they import in turn included."""
    graph, found, todo = imports(tree), set[str](), [start]
    while todo:
        name = todo.pop()
        if name not in found and name.startswith(below):
            found.add(name)
            todo.extend(graph[name])
    return found


def is_compiled_module(name: str) -> bool:
    """True for a module that has no functions but compiled ones, and none at all of its own is public Python."""
    path = ROOT / (name.replace(".", "/") + ".py")
    if not path.is_file():
        return False
    nodes = [node for node in sources("mecp_env")[path].body if isinstance(node, DEFINITIONS)]
    found = [bool({getattr(d, "id", "") for d in node.decorator_list} & set(COMPILED)) for node in nodes]
    return bool(found) and all(found)


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


def class_names_used_twice() -> dict[str, int]:
    """Names of classes that more than one file defines."""
    names = [
        node.name
        for tree in TREES
        for module in sources(tree).values()
        for node in ast.walk(module)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    return {name: count for name, count in sorted(Counter(names).items()) if count > 1}


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
    """The figures of the architecture issue."""
    compiled = [function for function in functions("mecp_env") if function.compiled]
    corners = reached("mecp_env", "mecp_env.slam.frontend.corners", "mecp_env.slam")
    return {
        "files at the root": len(root_files()),
        "import levels": levels(folders("mecp_env")),
        "compiled functions": len(compiled),
        "compiled functions with more than 8 arguments": sum(function.arguments > 8 for function in compiled),
        "tunable numbers of the estimator": len(tunable_numbers()),
        "code lines of slam/pipeline.py": code_lines(PACKAGE / "slam" / "pipeline.py"),
        "files to change corner extraction": sum(not is_compiled_module(name) for name in corners),
    }


if __name__ == "__main__":
    more = {
        "code lines of mecp_env and agents": sum(code_lines(path) for t in TREES[:2] for path in sources(t)),
        "class names used twice": len(class_names_used_twice()),
    }
    for what, number in (figures() | more).items():
        print(f"{number:6}  {what}")
    for name, count in class_names_used_twice().items():
        print(f"        {name}: {count} classes")
    for function in functions("mecp_env"):
        if function.arguments > (8 if function.compiled else 6) or function.complexity > (
            20 if function.compiled else 8
        ):
            print(f"        {function}")
