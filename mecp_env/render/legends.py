"""Legends that name what is drawn, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.lines import Line2D


def drawn(axes: Axes) -> dict[str, Any]:
    """`handles` and `labels` for a legend, of the artists that show something."""
    pairs = zip(*axes.get_legend_handles_labels(), strict=True)
    shown = [(artist, label) for artist, label in pairs if is_drawn(artist)]
    return {"handles": [artist for artist, _ in shown], "labels": [label for _, label in shown]}


def is_drawn(artist: Artist | Any) -> bool:
    """Whether an artist shows something: a line without a finite point shows nothing, a collection without a path."""
    if isinstance(artist, Line2D):
        return bool(np.isfinite(np.asarray(artist.get_xydata(), float)).all(axis=1).any())
    return len(artist.get_paths()) > 0 if isinstance(artist, Collection) else True
