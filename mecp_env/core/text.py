"""What is shown to a user, who may have got files and names from strangers."""

from __future__ import annotations


def readable(words: str) -> str:
    """Names come from files of strangers: what cannot be printed becomes a question mark."""
    return "".join(sign if sign.isprintable() else "?" for sign in words)
