"""The comparison as a Markdown page of tables.

Trainings that differ in their seed only, taken together: their mean, and what they differ by from other policies.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np

from mecp_env.core.intervals import Figures, over_runs
from mecp_env.policies.comparison import COMPARED, Row
from mecp_env.policies.setting import Setting, words_of

NUMBERED = re.compile(r"(.+)-\d+")
Runs = dict[str, list[Row]]


def seeds_of(rows: Sequence[Row]) -> list[Figures]:
    """A part for each group of runs `NAME-0`, `NAME-1`, ...: `policy` (`NAME-*`), `seeds`, `figures`, `differences`.

    `differences`, by the name of another group or policy, are means of the runs minus that, in the same buildings, with
    intervals over runs and buildings. Only rows of one estimator, which the caller selects, can be compared.
    """
    together = by_name(rows)
    groups = {name: runs for name, runs in together.items() if len(runs) > 1}
    return [
        {
            "policy": name,
            "estimator": runs[0].estimator,
            "seeds": len(runs),
            "figures": differences(runs, []),
            "differences": {other: differences(runs, row) for other, row in together.items() if other != name},
        }
        for name, runs in groups.items()
    ]


def by_name(rows: Sequence[Row]) -> Runs:
    """The rows under `NAME-*` where two or more are called `NAME-NUMBER`, the others under their own names."""
    found: Runs = {}
    for row in rows:
        numbered = NUMBERED.fullmatch(row.policy)
        found.setdefault(f"{numbered[1]}-*" if numbered else row.policy, []).append(row)
    return {name if len(runs) > 1 else runs[0].policy: runs for name, runs in found.items()}


def differences(runs: Sequence[Row], others: Sequence[Row]) -> Figures:
    """The compared metrics: mean of the runs, minus that of the others where there are any."""
    return {
        name: over_runs(
            np.stack([row.values(name) for row in runs]),
            np.stack([row.values(name) for row in others]) if others else None,
        )
        for name in COMPARED
    }


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
    parts = [
        f"# Policies\n\n{head}; docs/policies.md defines each column.",
        table(HEADLINE, labelled(rows)),
        section("Exploration", table(EXPLORATION, labelled(rows))),
        section("Localisation and map", table(LOCALISATION, labelled(rows))),
        section(
            f"Against `{result['reference']}`, in the same buildings",
            table(DIFFERENCES, labelled(rows, "against_reference")),
        ),
        section("The effect of a known pose", table(DIFFERENCES, labelled(rows, "with_the_pose_known"))),
        section(
            "The effect of known correspondences", table(DIFFERENCES, labelled(rows, "with_known_correspondences"))
        ),
        section("Trainings with several seeds, in the same buildings", seeds_table(result)),
        section("Return of lost episodes and of the others, in the same buildings", returns_table(result)),
        section("Decisions per second of CPU time", rates(result["timing"])),
        section("Episodes that failed", "\n".join(f"- {line}" for line in result["failures"])),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def where_of(result: Figures) -> str:
    """The buildings, and what differs from the default, in words."""
    setting, count = Setting(**result["setting"]), result["buildings"]
    words = [f"{count} buildings of the {setting.split} split of `{setting.task or setting.difficulty}`"]
    if setting.layout:
        words = [f"{count} episodes in {setting.plans} building{'s' * (setting.plans > 1)} of `{setting.place}`"]
        words += [f"robot of `{setting.task}`"] if setting.task else []
    words += [f"`{word}`" for word in words_of(setting.env)]
    words += [] if setting.estimator == "slam" else [f"estimator `{setting.estimator}`"]
    return ", ".join(words)


def section(title: str, body: str) -> str:
    """A heading and its body; nothing without a body."""
    return f"## {title}\n\n{body}" if body else ""


def labelled(rows: Iterable[Figures], part: str = "figures") -> list[tuple[str, Figures]]:
    """The name of each row that has that part, and the part."""
    return [(name_of(row), row[part]) for row in rows if part in row]


def name_of(row: Figures) -> str:
    """The label of a row: the policy, and the estimator where it has some ground truth."""
    known = {"truth": ", pose known", "known": ", known correspondences"}
    return f"{row['policy']}{known.get(row['estimator'], '')}"


def table(columns: Sequence[Column], rows: Sequence[tuple[str, Figures]]) -> str:
    """A table with one line per policy; nothing without rows."""
    if not rows:
        return ""
    lines = [f"| | {' | '.join(heading for heading, *_ in columns)} |", f"|{'---|' * (len(columns) + 1)}"]
    for name, figures in rows:
        cells = [cell(figures[key], form, factor) for _, key, form, factor in columns]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def overview(result: Figures) -> list[str]:
    """A short table for a terminal: score, difference to the reference, shares lost and complete of each policy."""
    metric, name = SCORES[bool(result["setting"].get("task"))]
    heads = ["policy", name, f"minus {result['reference']}", "lost, %", "complete, %"]
    lines = [heads]
    for row in result["rows"]:
        figures, against = row["figures"], row.get("against_reference", {})
        shares = [number(100.0 * figures[share]["value"], PERCENT) for share in ("lost", "complete")]
        difference = cell(against[metric], "+.3f", 1.0) if against else "-"
        lines.append([name_of(row), cell(figures[metric], ".3f", 1.0), difference, *shares])
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    rows = ["  ".join(f"{text:{width}}" for text, width in zip(line, widths, strict=True)).rstrip() for line in lines]
    return [where_of(result), "", *rows, *(f"failed: {failure}" for failure in result["failures"])]


def cell(figure: Figures, form: str, factor: float) -> str:
    """`value [low, high]` of an estimate, `value [-]` of a single run; a dash without one."""
    if figure["value"] is None:
        return "-"
    if figure.get("n") == 1:
        return f"{number(factor * figure['value'], form)} [-]"
    value, low, high = (number(factor * figure[end], form) for end in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


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
    returns = result.get("returns")
    if returns is None or returns["lost"]["value"] is None:
        return ""
    return table(RETURNS, [(f"{returns['lost']['n']} buildings with both", returns)])


def rates(timing: dict[str, float]) -> str:
    """Decisions per second of each policy."""
    return ", ".join(f"{name} {rate:,.0f}" for name, rate in timing.items())
