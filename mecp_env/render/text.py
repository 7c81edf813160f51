"""The line of figures above a picture."""

from __future__ import annotations

from collections.abc import Mapping

# shown name, format, and the names of the metrics it is made of; left out where one of them is missing
ITEMS = (
    ("rooms", "{:.0f}/{:.0f}", ("rooms_found", "rooms")),
    ("doors", "{:.0f}/{:.0f}", ("doors_found", "doors")),
    ("coverage", "{:.1%}", ("coverage",)),
    ("pose error", "{:.1f} cm", ("pose_error_cm",)),
    ("landmarks", "{:.0f}", ("landmarks",)),
)


def summary(metrics: Mapping[str, float]) -> list[tuple[str, str]]:
    """Pairs of a name and a readable value, as far as `metrics` has them (`pose_error_m` is shown in cm)."""
    known = dict(metrics)
    if "pose_error_m" in known:
        known["pose_error_cm"] = 100.0 * known["pose_error_m"]
    return [
        (name, form.format(*(known[key] for key in keys)))
        for name, form, keys in ITEMS
        if all(key in known for key in keys)
    ]
