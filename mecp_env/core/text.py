"""Text from untrusted files (names of buildings, rooms and files), before it is shown to a user."""

from __future__ import annotations


def sanitised(words: str) -> str:
    """`words` with a question mark for every character that cannot be printed, such as terminal control codes."""
    return "".join(sign if sign.isprintable() else "?" for sign in words)
