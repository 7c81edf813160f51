"""The tables of README.md and docs/policies.md, from results/policies.json: `python -m benchmarks.policy_tables`.

They are between `<!-- policies: NAME -->` and `<!-- end -->`; no figure is copied by hand.
"""

from __future__ import annotations

import json
import re
import sys

from benchmarks.common import RESULTS
from mecp_env.core.intervals import Figures
from mecp_env.policies.report_table import DIFFERENCES, HEADLINE, labelled, table

ROOT = RESULTS.parents[1]
RESULT = RESULTS / "policies.json"
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "policies.md")
PLACE = re.compile(r"(<!-- policies: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def tables(result: Figures) -> dict[str, str]:
    """The text of each place by its name."""
    rows, setting = result["rows"], result["setting"]
    estimated = [row for row in rows if row["estimator"] == setting["estimator"]]
    return {
        "where": f"{result['buildings']} buildings, `{setting['difficulty']}`, split `{setting['split']}`:",
        "short": table(HEADLINE, labelled(estimated)),
        "headline": table(HEADLINE, labelled(rows)),
        "differences": table(DIFFERENCES, labelled(estimated, "against_reference")),
        "known": table(DIFFERENCES, labelled(rows, "with_the_pose_known")),
    }


def updated(text: str, result: Figures) -> str:
    """A document with the tables of a result."""
    parts = tables(result)
    return PLACE.sub(lambda place: f"{place[1]}{parts[place[2]]}\n{place[3]}", text)


def main() -> int:
    """Update the documents."""
    result = json.loads(RESULT.read_text())
    for path in DOCUMENTS:
        path.write_text(updated(path.read_text(), result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
