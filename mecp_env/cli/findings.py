"""What a check of `mecp-env doctor` finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["PASS", "WARN", "FAIL"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One line: the verdict, on what, what was found, and what to do about it."""

    verdict: Verdict
    name: str
    said: str
    fix: str = ""
