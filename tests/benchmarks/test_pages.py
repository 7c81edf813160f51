"""The tables of the documents are those of the result."""

import json
import re

import pytest

from benchmarks import pages
from mecp_env.core.errors import ConfigError
from mecp_env.core.provenance import checksum
from mecp_env.policies import suites


@pytest.mark.parametrize("path", pages.DOCUMENTS, ids=lambda path: path.name)
def test_the_tables_of_the_documents_follow_from_the_results(path) -> None:
    text = path.read_text()
    assert len(re.findall("<!-- policies: ", text)) == len(pages.PLACE.findall(text)) >= 1
    assert pages.updated(text, pages.tables()) == text


def test_a_place_is_filled_and_the_rest_stays() -> None:
    text = "before\n<!-- policies: here -->\nold\nolder\n<!-- end -->\nafter\n"
    filled = pages.updated(text, {"here": "| new |"})
    assert filled == text.replace("old\nolder", "| new |")


def test_the_tables_of_frozen_benchmarks_are_those_of_their_files(tmp_path) -> None:
    figure = {"value": 0.5, "low": 0.4, "high": 0.6}
    rows = [
        {"task": "medium", "policy": name, "estimator": "slam", "figures": dict.fromkeys(suites.METRICS, figure)}
        for name in ("mine", "yours")
    ]
    content = {"format": suites.FORMAT, "version": suites.VERSION, "suite": "coverage-v1"}
    content |= {"hash": suites.SUITES["coverage-v1"].frozen, "results": [row | {"episodes": []} for row in rows]}
    signed = content | {"checksum": checksum(json.dumps(content, sort_keys=True).encode())}
    (tmp_path / "a.json").write_text(json.dumps(signed))
    text = pages.suite_tables(tmp_path)
    assert "`active-v1`, hash " in text
    assert ": no result yet." in text
    assert "| mine | 0.500 [0.400, 0.600] |" in text
    (tmp_path / "b.json").write_text(json.dumps(signed | {"hash": "0"}))
    with pytest.raises(ConfigError, match=r"b\.json: suite coverage-v1 with the hash 0"):
        pages.suite_tables(tmp_path)
