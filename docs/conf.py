"""The site: `sphinx-build -W -c docs . runs/site`. Its source is the repository, so that links hold in both."""

import dataclasses
import inspect
import os
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

import environment_pages  # noqa: E402
from field_tables import comments  # noqa: E402
from pydantic import BaseModel  # noqa: E402
from wide_tables import fit_tables  # noqa: E402

import mecp_env  # noqa: E402

project, author, copyright = "mecp_env", "the mecp_env developers", "2026, the mecp_env developers"
version = release = mecp_env.__version__
root_doc = "docs/index"
include_patterns = ["docs/**", "benchmarks/results/*.md", "README.md", "CHANGELOG.md", "CONTRIBUTING.md"]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.viewcode", "sphinx_copybutton"]
templates_path = ["_templates"]
nitpicky = True

myst_heading_anchors = 3
os.environ |= {"NOTEBOOK_SHORT": "1", "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_render_markdown_format = "myst"  # with tables

default_role = "code"  # our docstrings mark code by single backquotes
autodoc_default_options = {"members": True, "member-order": "bysource"}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_type_aliases = {name: name for name in ("Array", "Ints", "Bools", "Bytes", "Rows")}
nitpick_ignore_regex = [("py:.*", ".*")]  # types of libraries, and of what is not public
autodoc_preserve_defaults = True

html_theme = "furo"
html_title = "mecp_env"
html_additional_pages = {"index": "to_the_start.html"}
html_show_sphinx = False
html_static_path, html_css_files = ["_static"], ["tables.css"]

ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")  # how autodoc writes a name of `autodoc_type_aliases` in a union
BELOW = {  # a page with a list -> the pages of that list
    "docs/decisions/README": "docs/decisions/0*.md",
    "docs/results": "benchmarks/results/*.md",
}


def add_toctree(app: Any, name: str, source: list[str]) -> None:
    """Put pages below the page that lists them; a repository browser shows the list alone."""
    if name in BELOW:
        pages = sorted(path.relative_to(ROOT).with_suffix("") for path in ROOT.glob(BELOW[name]))
        entries = (f"{page.name.replace('_', ' ').replace('-', ' ')} </{page}>" for page in pages)
        source[0] += "\n```{toctree}\n:hidden:\n\n" + "\n".join(entries) + "\n```\n"


def add_fields(app: Any, what: str, name: str, item: Any, options: object, lines: list[str]) -> None:
    """Add fields with their comments; cut Markdown sections, which the pages of the environments contain."""
    del lines[next((row for row, line in enumerate(lines) if line.startswith("## ")), len(lines)) :]
    lines[:] = [re.sub(r"\|(\w+)\|", r"\|\1\|", line) for line in lines]
    if isinstance(item, type) and (dataclasses.is_dataclass(item) or issubclass(item, BaseModel)):
        fields = [(field, text) for field, text in comments(item).items() if field[0] != "_"]
        kinds = types_of(item)
        typed = [(f"- `{field}: {kinds[field]}`", escaped(text)) for field, text in fields]
        lines += ["", *(f"{field} -- {text}" if text else field for field, text in typed), ""]


def types_of(item: type) -> dict[str, str]:
    """The type of each field as its source has it, without the bounds that its comment or its error names."""
    found = {}
    for base in reversed(item.__mro__):
        for name, kind in vars(base).get("__annotations__", {}).items():
            text = kind if isinstance(kind, str) else getattr(kind, "__name__", str(kind))
            found[name] = re.sub(r"^Annotated\[(.+?), .*\]$", r"\1", text.strip("'")).replace("`", "")
    return found


def signature_of(app: Any, what: str, name: str, item: Any, options: object, given: str | None, returned: Any) -> Any:
    """The signature; of a configuration its names alone: the list of its fields has types and meaning."""
    if isinstance(item, type) and issubclass(item, BaseModel):
        names = [name for name in inspect.signature(item).parameters if name[0] != "_"]
        return f"(*, {', '.join(names)})" if names else "()", None
    return tuple(text and ALIAS.sub(r"\1", text) for text in (given, returned))


def escaped(text: str) -> str:
    """A comment in reStructuredText."""
    return text.replace("\\", "\\\\").replace("*", "\\*").replace("|", "\\|")


def skip_pydantic(app: Any, what: str, name: str, item: object, skipped: bool, options: object) -> bool | None:
    """Leave out what pydantic adds to a configuration."""
    return True if name.startswith("model_") else None


def setup(app: Any) -> None:
    """Write what follows from the code before anything is read."""
    app.connect("builder-inited", lambda app: environment_pages.write(ROOT / "docs/environments"))
    app.connect("source-read", add_toctree)
    app.connect("doctree-read", fit_tables)
    app.connect("autodoc-process-docstring", add_fields)
    app.connect("autodoc-process-signature", signature_of)
    app.connect("autodoc-skip-member", skip_pydantic)
