"""Figures as tables: the page of a comparison in Markdown, and a short table for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mecp_env.core.intervals import Figures
from mecp_env.policies.setting import Setting, words_of

Column = tuple[str, str, str, float]  # heading, name of the figure, format, factor

PERCENT, PLAIN = ".0f", ".1f"
SCORES = {True: ("correct_over_steps", "correct coverage over steps"), False: ("auc", "area under the curve")}  # task?
HEADLINE: tuple[Column, ...] = (
    ("correct coverage over steps", "correct_over_steps", ".3f", 1.0),
    ("over metres", "correct_over_metres", ".3f", 1.0),
    ("at the end, %", "correct_coverage", PLAIN, 100.0),
    ("lost, %", "lost", PERCENT, 100.0),
    ("area under the curve", "auc", ".3f", 1.0),
    ("m to 90 %", "metres_to_90%", PERCENT, 1.0),
    ("m to 99 %", "metres_to_99%", PERCENT, 1.0),
    ("complete, %", "complete", PERCENT, 100.0),
    ("pose error, cm", "pose_error_mean_m", PLAIN, 100.0),
    ("at the end, cm", "pose_error_final_m", PLAIN, 100.0),
)
EXPLORATION: tuple[Column, ...] = (
    ("reached 90 %, %", "reached_90%", PERCENT, 100.0),
    ("reached 99 %, %", "reached_99%", PERCENT, 100.0),
    ("steps to 90 %", "periods_to_90%", PERCENT, 1.0),
    ("steps to 99 %", "periods_to_99%", PERCENT, 1.0),
    ("rooms found, %", "rooms_found", PLAIN, 100.0),
    ("doors found, %", "doors_found", PLAIN, 100.0),
    ("coverage, %", "coverage", PLAIN, 100.0),
    ("m in all", "metres", PERCENT, 1.0),
    ("decisions", "decisions", PERCENT, 1.0),
    ("return", "reward", ".3f", 1.0),
)
LOCALISATION: tuple[Column, ...] = (
    ("log det of the pose covariance", "log_det_mean", PLAIN, 1.0),
    ("map error, cm", "map_rmse_m", PLAIN, 100.0),
    ("landmarks", "landmarks", PLAIN, 1.0),
    ("of no corner", "landmarks_false", ".2f", 1.0),
    ("duplicates", "duplicates", ".2f", 1.0),
    ("contacts per 100 m", "contacts_per_100_m", ".2f", 1.0),
    ("diverged, %", "diverged", PLAIN, 100.0),
)
DIFFERENCES: tuple[Column, ...] = (
    ("correct coverage over steps", "correct_over_steps", "+.3f", 1.0),
    ("over metres", "correct_over_metres", "+.3f", 1.0),
    ("at the end, %", "correct_coverage", "+.1f", 100.0),
    ("area under the curve", "auc", "+.3f", 1.0),
    ("m to 90 %", "metres_to_90%", "+.1f", 1.0),
    ("m to 99 %", "metres_to_99%", "+.1f", 1.0),
    ("steps to 90 %", "periods_to_90%", "+.0f", 1.0),
    ("pose error at the end, cm", "pose_error_final_m", "+.2f", 100.0),
)
RETURNS: tuple[Column, ...] = (
    ("lost", "lost", ".3f", 1.0),
    ("others", "others", ".3f", 1.0),
    ("lost - others", "difference", "+.3f", 1.0),
    ("lost / others", "ratio", ".2f", 1.0),
    ("correlation with correct coverage", "correlation", ".2f", 1.0),
)


def page(result: Figures) -> str:
    """The whole page of a result of `mecp-env evaluate`."""
    rows = result["rows"]
    head = f"{result['date']}, `{result['command']}`; {where_of(result)}. Means with 95 % intervals"
    against = f"Against `{result['reference']}`, in the same buildings"
    sections = {
        "Exploration": table(EXPLORATION, labelled(rows)),
        "Localisation and map": table(LOCALISATION, labelled(rows)),
        against: table(DIFFERENCES, labelled(rows, "against_reference")),
        "The effect of a known pose": table(DIFFERENCES, labelled(rows, "with_the_pose_known")),
        "The effect of known correspondences": table(DIFFERENCES, labelled(rows, "with_known_correspondences")),
        "Trainings with several seeds, in the same buildings": seeds_table(result),
        "Return of lost episodes and of the others, in the same buildings": returns_table(result),
        "Decisions per second of CPU time": ", ".join(f"{name} {n:,.0f}" for name, n in result["timing"].items()),
        "Episodes that failed": "\n".join(f"- {line}" for line in result["failures"]),
    }
    parts = [f"# Policies\n\n{head}; docs/policies.md defines each column.", table(HEADLINE, labelled(rows))]
    return "\n\n".join(parts + [f"## {title}\n\n{body}" for title, body in sections.items() if body]) + "\n"


def where_of(result: Figures) -> str:
    """The buildings, and what differs from the default, in words."""
    setting, count = Setting(**result["setting"]), result["buildings"]
    words = [f"{count} buildings of the {setting.split} split of `{setting.name}`"]
    if setting.layout:
        words = [f"{count} episodes in {setting.plans} building{'s' * (setting.plans > 1)} of `{setting.place}`"]
        words += [f"robot of `{setting.task}`"] if setting.task else []
    words += [f"`{word}`" for word in words_of(setting.env)]
    words += [] if setting.estimator == "slam" else [f"estimator `{setting.estimator}`"]
    return ", ".join(words)


def labelled(rows: Iterable[Figures], part: str = "figures") -> list[tuple[str, Figures]]:
    """The name of each row that has that part, and the part."""
    return [(name_of(row), row[part]) for row in rows if part in row]


def name_of(row: Figures) -> str:
    """The label of a row: the policy, and the estimator where it has some ground truth."""
    known = {"truth": ", pose known", "known": ", known correspondences"}
    return f"{row['policy']}{known.get(row['estimator'], '')}"


def table(columns: Sequence[Column], rows: Sequence[tuple[str, Figures]]) -> str:
    """A table with one line per policy; nothing without rows."""
    lines = [[name, *(cell(figures[key], form, by) for _, key, form, by in columns)] for name, figures in rows]
    return markdown_table(["", *(heading for heading, *_ in columns)], lines) if rows else ""


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts in Markdown."""
    lines = ["".join(f" {text} |" if text else " |" for text in line) for line in (header, *rows)]
    return "\n|".join([f"|{lines[0]}", "---|" * len(header), *lines[1:]])


def overview(result: Figures) -> list[str]:
    """A short table for a terminal: score, difference to the reference, shares lost and complete of each policy."""
    metric, name = SCORES[bool(result["setting"].get("task"))]
    lines = [["policy", name, f"minus {result['reference']}", "lost, %", "complete, %"]]
    for row in result["rows"]:
        figures, against = row["figures"], row.get("against_reference", {})
        shares = [number(100.0 * figures[share]["value"], PERCENT) for share in ("lost", "complete")]
        lines.append([name_of(row), cell(figures[metric], ".3f"), cell(against.get(metric), "+.3f"), *shares])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rows = ["  ".join(f"{text:{width}}" for text, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    return [where_of(result), "", *rows, *(f"failed: {failure}" for failure in result["failures"])]


def cell(figure: Figures | None, form: str, factor: float = 1.0) -> str:
    """`value [low, high]` of an estimate, `value [-]` of a single run; a dash without one."""
    if figure is None or figure["value"] is None:
        return "-"
    value, low, high = (number(factor * figure[end], form) for end in ("value", "low", "high"))
    return f"{value} [-]" if figure.get("n") == 1 else f"{value} [{low}, {high}]"


def number(value: float, form: str) -> str:
    """A number as text; a value that is rounded to 0 has no sign."""
    text = f"{value:{form}}"
    return text if float(text) else text.lstrip("+-")


def seeds_table(result: Figures, columns: Sequence[Column] = DIFFERENCES) -> str:
    """The mean of each group of trainings minus each other policy; nothing of a result without groups."""
    rows = [
        (f"{group['policy']} ({group['seeds']} seeds) - {other}", figures)
        for group in result.get("seeds", ())
        for other, figures in group["differences"].items()
    ]
    return table(columns, rows)


def returns_table(result: Figures) -> str:
    """Returns against the map, over all policies with the estimator; nothing of a result from before it was measured.

    A ratio without a positive return of the others has no meaning and is a dash.
    """
    found = [part for part in [result.get("returns")] if part and part["lost"]["value"] is not None]
    return table(RETURNS, [(f"{part['lost']['n']} buildings with both", part) for part in found])
