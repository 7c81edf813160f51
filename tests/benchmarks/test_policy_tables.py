"""The tables of the documents are those of the result."""

from __future__ import annotations

import json
import re

import pytest

from benchmarks import policy_tables


@pytest.mark.parametrize("path", policy_tables.DOCUMENTS, ids=lambda path: path.name)
def test_the_tables_of_the_documents_follow_from_the_result(path) -> None:
    text = path.read_text()
    assert len(re.findall("<!-- policies: ", text)) == len(policy_tables.PLACE.findall(text)) >= 2
    assert policy_tables.updated(text, json.loads(policy_tables.RESULT.read_text())) == text


def test_a_place_is_filled_and_the_rest_stays() -> None:
    result = {"rows": [], "buildings": 3, "setting": {"estimator": "slam", "difficulty": "easy", "split": "test"}}
    text = "before\n<!-- policies: where -->\nold\nolder\n<!-- end -->\nafter\n"
    filled = policy_tables.updated(text, result)
    assert filled == text.replace("old\nolder", "3 buildings, `easy`, split `test`:")
    assert policy_tables.updated(filled, result) == filled
