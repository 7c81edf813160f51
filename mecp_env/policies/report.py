"""A comparison as tables for a page in Markdown and for a terminal, as curves, and as a film of all policies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mecp_env.core.carriers import Bytes
from mecp_env.core.files import sanitised
from mecp_env.core.intervals import BUDGET_M_PER_M2, Figures
from mecp_env.policies.evaluation import COMPARED, SHARES_OF_BUDGET
from mecp_env.policies.registry import make_policy
from mecp_env.policies.rollout import Info, make_rooms, run_policy
from mecp_env.policies.setting import Setting
from mecp_env.render.palette import FAINT, INK, MARKERS, SERIES, unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mecp_env.render.screen import Film

Columns = dict[str, tuple[str, str, float]]  # of a figure: heading, format, factor

HEADLINE: Columns = {
    "correct_over_steps": ("correct coverage over steps", ".3f", 1.0),
    "correct_over_metres": ("over metres", ".3f", 1.0),
    "correct_coverage": ("at the end, %", ".1f", 100.0),
    "lost": ("lost, %", ".0f", 100.0),
    "auc": ("area under the curve", ".3f", 1.0),
    "metres_to_90%": ("m to 90 %", ".1f", 1.0),
    "metres_to_99%": ("m to 99 %", ".1f", 1.0),
    "complete": ("complete, %", ".0f", 100.0),
    "pose_error_mean_m": ("pose error, cm", ".1f", 100.0),
    "pose_error_final_m": ("pose error at the end, cm", ".2f", 100.0),
}
EXPLORATION: Columns = {
    "reached_90%": ("reached 90 %, %", ".0f", 100.0),
    "reached_99%": ("reached 99 %, %", ".0f", 100.0),
    "periods_to_90%": ("steps to 90 %", ".0f", 1.0),
    "periods_to_99%": ("steps to 99 %", ".0f", 1.0),
    "rooms_found": ("rooms found, %", ".1f", 100.0),
    "doors_found": ("doors found, %", ".1f", 100.0),
    "coverage": ("coverage, %", ".1f", 100.0),
    "metres": ("m in all", ".0f", 1.0),
    "decisions": ("decisions", ".0f", 1.0),
    "reward": ("return", ".3f", 1.0),
}
LOCALISATION: Columns = {
    "log_det_mean": ("log det of the pose covariance", ".1f", 1.0),
    "map_rmse_m": ("map error, cm", ".1f", 100.0),
    "landmarks": ("landmarks", ".1f", 1.0),
    "landmarks_false": ("of no corner", ".2f", 1.0),
    "duplicates": ("duplicates", ".2f", 1.0),
    "contacts_per_100_m": ("contacts per 100 m", ".2f", 1.0),
    "diverged": ("diverged, %", ".1f", 100.0),
}
COLUMNS = HEADLINE | EXPLORATION | LOCALISATION
SCORES = {True: ("correct_over_steps", "correct coverage over steps"), False: ("auc", "area under the curve")}  # task?
DPI = 200
PANEL = (320, 290)  # px
ACROSS = 3  # panels in a row
MOST_FRAMES, EVERY = 64, 4  # of a policy, and steps between the first of them
LONGEST = 900  # steps: longer episodes are cut
FIRST = 0, 0  # building and seed
MARK_EVERY = 0.12  # of the diagonal, from marker to marker of a curve


def page(result: Figures) -> str:
    """The whole page of a result of `mecp-env evaluate`."""
    rows = result["rows"]
    head = f"{result['date']}, `{result['command']}`; {where_of(result)}. Means with 95 % intervals"
    against = f"Against `{result['reference']}`, in the same buildings"
    sections = {
        "Exploration": table(EXPLORATION, labelled(rows)),
        "Localisation and map": table(LOCALISATION, labelled(rows)),
        against: table(COMPARED, labelled(rows, "against_reference"), "+"),
        "The effect of a known pose": table(COMPARED, labelled(rows, "with_the_pose_known"), "+"),
        "The effect of known correspondences": table(COMPARED, labelled(rows, "with_known_correspondences"), "+"),
        "Trainings with several seeds, in the same buildings": seeds_table(result),
        "Decisions per second of CPU time": ", ".join(f"{name} {n:,.0f}" for name, n in result["timing"].items()),
        "Episodes that failed": "\n".join(f"- {line}" for line in result["failures"]),
    }
    parts = [f"# Policies\n\n{head}; docs/policies.md defines each column.", table(HEADLINE, labelled(rows))]
    return "\n\n".join(parts + [f"## {title}\n\n{body}" for title, body in sections.items() if body]) + "\n"


def where_of(result: Figures) -> str:
    """The number of episodes, the buildings, and what differs from the default, in words."""
    setting, count = Setting(**result["setting"]), result["buildings"]
    plans = f"{count} episodes in {setting.plans} building{'s' * (setting.plans > 1)}"
    estimator = "" if setting.estimator == "slam" else f", estimator {setting.estimator}"
    return f"{plans if setting.layout else f'{count} buildings'}: {setting.where}{estimator}"


def labelled(rows: Iterable[Figures], part: str = "figures") -> list[tuple[str, Figures]]:
    """The name of each row that has that part, and the part."""
    return [(name_of(row), row[part]) for row in rows if part in row]


def name_of(row: Figures) -> str:
    """The label of a row: the policy, and the estimator where it has some ground truth."""
    known = {"truth": ", pose known", "known": ", known correspondences"}
    return f"{row['policy']}{known.get(row['estimator'], '')}"


def table(names: Iterable[str], rows: Sequence[tuple[str, Figures]], sign: str = "") -> str:
    """A table with one line per policy, of differences with a sign; nothing without rows."""
    columns = [(name, *COLUMNS[name]) for name in names]
    lines = [[label, *(cell(of[key], sign + form, by) for key, _, form, by in columns)] for label, of in rows]
    return markdown_table(["", *(heading for _, heading, *_ in columns)], lines) if rows else ""


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
        shares = [number(100.0 * figures[share]["value"], ".0f") for share in ("lost", "complete")]
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


def seeds_table(result: Figures) -> str:
    """The mean of each group of trainings minus each other policy; nothing of a result without groups."""
    rows = [
        (f"{group['policy']} ({group['seeds']} seeds) - {other}", figures)
        for group in result.get("seeds", ())
        for other, figures in group["differences"].items()
    ]
    return table(COMPARED, rows, "+")


def draw_curves(rows: list[Figures], title: str, path: Path) -> None:
    """Write the mean coverage over the metres driven as a PNG.

    The first row of each policy has a band, its 95 % interval; the row with the pose known is dashed.
    """
    from matplotlib.figure import Figure  # matplotlib is loaded only for a figure

    from mecp_env.render.figures import open_axes, save

    figure = Figure(figsize=(9.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for number, policy in enumerate(dict.fromkeys(row["policy"] for row in rows)):
        draw_policy(axes, [row for row in rows if row["policy"] == policy], number)
    axes.set_title(title, loc="left", fontsize=11, color=unit(INK))
    axes.set_xlabel(f"metres driven, as a share of the building's budget ({BUDGET_M_PER_M2:g} m per m² of floor)")
    axes.set_ylabel("floor seen, %")
    axes.set_xlim(0.0, float(SHARES_OF_BUDGET[-1]))
    axes.set_ylim(0.0, 1.02)
    axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}")
    axes.axvline(1.0, color=unit(FAINT), linewidth=0.8, linestyle=":")
    open_axes(axes)
    heading = "area under the curve up to 1\n(dashed: pose known)"
    figure.legend(loc="outside right upper", frameon=False, fontsize=9, title=heading, title_fontsize=9)
    save(figure, path, DPI)


def draw_policy(axes: Axes, rows: list[Figures], number: int) -> None:
    """The curves of one policy in its colour and with its marker, the first with its band and the areas under both."""
    colour, marker = (choices[number % len(choices)] for choices in (list(map(unit, SERIES)), MARKERS))
    low, value, high = ([point[end] for point in rows[0]["curve"]] for end in ("low", "value", "high"))
    area, *known = (f"{row['figures']['auc']['value']:.3f}" for row in rows)
    label = f"{sanitised(rows[0]['policy'])}  {area}" + "".join(f" ({other})" for other in known)
    looks: dict[str, Any] = {"marker": marker, "markersize": 5, "markevery": (0.02 * (number % 6), MARK_EVERY)}
    axes.plot(SHARES_OF_BUDGET, value, color=colour, linewidth=1.8, label=label, **looks)
    axes.fill_between(SHARES_OF_BUDGET, low, high, color=colour, alpha=0.15, linewidth=0.0)
    for row in rows[1:]:
        axes.plot(SHARES_OF_BUDGET, [point["value"] for point in row["curve"]], "--", color=colour, linewidth=1.0)


def write_film(policies: Sequence[str], setting: Setting, path: Path, trust: bool = False) -> None:
    """Write the film of all policies in one building as a GIF; long episodes are cut."""
    from mecp_env.render.screen import Film

    shorter = replace(setting, max_steps=min(setting.max_steps, LONGEST))
    films = [record(policy, shorter, trust) for policy in policies]
    every = max(film.every for film in films)
    last = max(film.every * (len(film) - 1) for film in films)
    whole = Film()
    for step in range(0, last + every, every):  # an episode that is over stays at its last picture
        whole.add(mosaic([film[min(-(-step // film.every), len(film) - 1)] for film in films]))
    whole.save(path)


def record(policy: str, setting: Setting, trust: bool = False) -> Film:
    """What the robot believes at every n-th step of an exploration, and at its end, with time, metres and coverage."""
    from mecp_env.render.screen import Film, thumbnail  # pygame is loaded only for a film

    made, film = make_policy(policy, trust), Film(MOST_FRAMES, EVERY)
    env = make_rooms(setting, made)
    period_s = env.get_wrapper_attr("config").robot.period_s

    def picture(info: Info, ended: str = "") -> Bytes:
        """The belief below time, metres and coverage."""
        words = f"{period_s * info['period']:.0f} s    {info['metres']:.0f} m    {info['coverage']:.0%} seen{ended}"
        return thumbnail(env.get_wrapper_attr("view")(), PANEL, policy, words)

    last = run_policy(env, made, lambda info: film.offer(info["period"], lambda: picture(info)), FIRST)
    film.add(picture(last, "    ..." if last["goals"] else "    done"))
    env.close()
    return film


def mosaic(pictures: list[Bytes]) -> Bytes:
    """The pictures in rows of three; missing ones have the colour of their border."""
    across = min(ACROSS, len(pictures))
    filled = pictures + [np.full_like(pictures[0], pictures[0][0, 0])] * (-len(pictures) % across)
    return np.vstack([np.hstack(filled[i : i + across]) for i in range(0, len(filled), across)])
