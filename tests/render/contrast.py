"""Contrast of two colours by WCAG 2.1."""

import re
from collections.abc import Sequence


def parsed(colour: str) -> tuple[int, ...]:
    """Red, green, blue, 0..255, of `#rrggbb` or `rgb(r, g, b)`."""
    if colour.startswith("#"):
        return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return tuple(int(value) for value in re.findall(r"\d+", colour)[:3])


def luminance(colour: Sequence[float]) -> float:
    """Relative luminance, 0 to 1."""
    parts = [c / 255 / 12.92 if c <= 0.03928 * 255 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in colour[:3]]
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]


def contrast(a: Sequence[float], b: Sequence[float]) -> float:
    """1 to 21."""
    dark, light = sorted([luminance(a), luminance(b)])
    return (light + 0.05) / (dark + 0.05)
