"""Write the list of functions that are compiled ahead: `python -m mecp_env.cli.record_signatures`.

The episodes run twice, in two processes: only one that finds everything in the cache asks it for a function when Python
calls that, and not when a compiled function does.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mecp_env.cli.exercise import exercise
from mecp_env.core.jit_cache import _FunctionCache, within_another_compilation
from mecp_env.core.warm_up_list import LIST, Entry, encode

EXERCISE = "from mecp_env.cli.exercise import exercise; exercise()"


@contextmanager
def noted_calls() -> Iterator[dict[str, Entry]]:
    """The functions that Python calls within it for the first time, with their types, in their order."""
    found: dict[str, Entry] = {}
    owner: Any = _FunctionCache
    load = owner.load_overload

    def load_and_note(cache: Any, sig: Any, context: Any) -> Any:
        function = cache._function
        if not within_another_compilation(sys._getframe(1)):
            entry = [function.__module__, function.__name__, [encode(argument) for argument in sig]]
            found.setdefault(json.dumps(entry), entry)
        return load(cache, sig, context)

    owner.load_overload = load_and_note
    try:
        yield found
    finally:
        owner.load_overload = load


def main() -> None:
    """Fill the cache, then record."""
    subprocess.run([sys.executable, "-c", EXERCISE], check=True)
    with noted_calls() as found:
        exercise()
    lines = ",\n".join(found)
    LIST.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
