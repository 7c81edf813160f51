"""The paper's mode, stage by stage, on the same drives, for both readings of the laser's noise (IV).

`mecp_paper` has the association of the paper, and features and filter of ours, and the rows after it change one choice
each (`no polygons` is the nearest neighbour in the room); `SlamConfig.paper()` is the paper's in every stage; `with
dobkin` has the polygon search as written, too, with its kernel rule. Columns are those of `association`; `found` and
`recognised` are the shares of scans with a polygon, and with one that is recognised. In `paper` the noise that the
filter assumes is on every beam; in `paper_ideal` the laser is ideal.
"""

from __future__ import annotations

from typing import Any

from benchmarks import association
from benchmarks.association import IDEAL, LETTER
from benchmarks.columns import columns_of, ratios
from benchmarks.common import Figures, Gate, Options, runs_of
from benchmarks.drives import replay
from benchmarks.records import IN_MEMORY, Records, on_records
from benchmarks.tables import sections, table_of
from benchmarks.variants import DEFAULT, with_change

SEEDS = {"paper": 60, IDEAL: 15}
SETS, MOST = tuple(SEEDS), 1000
RULE, DOBKIN = "mecp_paper", f"{LETTER} with dobkin"
CHANGES: dict[str, dict[str, Any]] = {  # one choice at a time
    "posts as landmarks": {"use_posts": True},
    "gate .99995": {"gate_probability": 0.99995},
    "descriptor": {"use_descriptor": True},
    "no polygons": {"method": "nearest_room"},
}
COLUMNS = ("precision", "recall", "closure_recall", "false_closures", "duplicates_per_corner", "swapped_per_1000")
COLUMNS += ("found", "recognised", "rmse_m", "map_rmse_m", "nees", "landmark_nees", "lost")

GATES = (
    Gate("paper/mecp_paper/precision", "share", 0.03),
    Gate(f"paper/{LETTER}/precision", "share", 0.03),
)


def rows() -> dict[str, dict[str, Any]]:
    """What is compared, and what each changes in the default estimator."""
    known = association.methods()
    paper, letter = known[RULE]["association"], known[LETTER]
    return {
        **{name: known[name] for name in (DEFAULT, RULE)},
        **{f"{RULE}, {name}": {"association": paper | change} for name, change in CHANGES.items()},
        LETTER: letter,
        DOBKIN: letter | {"polygon": letter["polygon"] | {"structure": "dobkin"}},
        "nearest": known["nearest"],
    }


def run(options: Options) -> Figures:
    """Results of both readings and every row."""
    runs = on_records(measure, dict[str, Figures], runs_of(options, SEEDS, MOST, 2), options)
    return {layout: {name: summary([run[name] for run in of]) for name in rows()} for layout, of in runs.items()}


def measure(drive_of: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each row on the drive of one layout and seed."""
    drive = records.drive(association.course(*drive_of))
    return {
        name: association.counts(drive, replay(drive, with_change(drive.slam, change)))
        for name, change in rows().items()
    }


def summary(runs: list[Figures]) -> Figures:
    """Figures of one row over all drives, with 95 % intervals."""
    polygons = ratios(columns_of(runs), found="found/scans", recognised="recognised/scans")
    return {**association.summarise(runs), **polygons}


def report(figures: Figures) -> str:
    """One table per reading."""
    return sections(
        {f"{name} ({of[DEFAULT]['precision']['n']} drives)": table_of("", COLUMNS, of) for name, of in figures.items()}
    )
