"""The tables of README.md and docs/policies.md, from benchmarks/results/policies.json.

They stand between `<!-- policies: NAME -->` and `<!-- end -->`; nobody copies figures by hand.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from mecp_env.core.intervals import Figures
from mecp_env.policies.page import DIFFERENCES, HEADLINE, labelled, table

ROOT = Path(__file__).parents[2]
RESULT = ROOT / "benchmarks" / "results" / "policies.json"
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "policies.md")
PLACE = re.compile(r"(<!-- policies: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def tables(result: Figures) -> dict[str, str]:
    """The text of each place by its name."""
    rows, setting = result["rows"], result["setting"]
    unsure = [row for row in rows if row["estimator"] == setting["estimator"]]
    return {
        "where": f"{result['buildings']} buildings, `{setting['difficulty']}`, split `{setting['split']}`:",
        "short": table(HEADLINE, labelled(unsure)),
        "headline": table(HEADLINE, labelled(rows)),
        "differences": table(DIFFERENCES, labelled(unsure, "against_reference")),
        "known": table(DIFFERENCES, labelled(rows, "with_the_pose_known")),
    }


def refreshed(text: str, result: Figures) -> str:
    """A document with the tables of a result."""
    parts = tables(result)
    return PLACE.sub(lambda place: f"{place[1]}{parts[place[2]]}\n{place[3]}", text)


def main() -> int:
    """Bring the documents up to the result."""
    result = json.loads(RESULT.read_text())
    for path in DOCUMENTS:
        path.write_text(refreshed(path.read_text(), result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
