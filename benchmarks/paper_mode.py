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
from benchmarks.association import IDEAL
from benchmarks.common import Figures, Options
from benchmarks.records import IN_MEMORY, Records, on_drives
from benchmarks.tables import summaries
from benchmarks.variants import DEFAULT, LETTER, changed, rows_of

SETS = {"paper": 60, IDEAL: 15}
RULE, DOBKIN = "mecp_paper", f"{LETTER} with dobkin"
CHANGES: dict[str, dict[str, Any]] = {  # one choice at a time
    "posts as landmarks": {"use_posts": True},
    "gate .99995": {"gate_probability": 0.99995},
    "descriptor": {"use_descriptor": True},
    "no polygons": {"method": "nearest_room"},
}
ROWS = {
    **rows_of(DEFAULT, RULE),
    **{f"{RULE}, {name}": changed(RULE, {"association": change}) for name, change in CHANGES.items()},
    **rows_of(LETTER),
    DOBKIN: changed(LETTER, {"polygon": {"structure": "dobkin"}}),
    **rows_of("nearest"),
}
COLUMNS = ("precision", "recall", "closure_recall", "false_closures", "duplicates_per_corner", "swapped_per_1000")
COLUMNS += ("found", "recognised", "rmse_m", "map_rmse_m", "nees", "landmark_nees", "lost")


def run(options: Options) -> Figures:
    """Results of both readings and every row."""
    return {layout: summaries(rows, COLUMNS) for layout, rows in on_drives(measure, SETS, options).items()}


def measure(drive_of: tuple[str, int], records: Records = IN_MEMORY) -> dict[str, Figures]:
    """Counts of each row on the drive of one layout and seed."""
    return association.counted(records.drive(association.course(*drive_of)), ROWS)
