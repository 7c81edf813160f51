"""The tables of the documents are those of the result."""

from __future__ import annotations

import json
import re

import pytest

from mecp_env.policies import documents


@pytest.mark.parametrize("path", documents.DOCUMENTS, ids=lambda path: path.name)
def test_the_tables_of_the_documents_follow_from_the_result(path) -> None:
    text = path.read_text()
    assert len(re.findall("<!-- policies: ", text)) == len(documents.PLACE.findall(text)) >= 2
    assert documents.refreshed(text, json.loads(documents.RESULT.read_text())) == text


def test_a_place_is_filled_and_the_rest_stays() -> None:
    result = {"rows": [], "buildings": 3, "setting": {"estimator": "slam", "difficulty": "easy", "split": "test"}}
    text = "before\n<!-- policies: where -->\nold\nolder\n<!-- end -->\nafter\n"
    filled = documents.refreshed(text, result)
    assert filled == text.replace("old\nolder", "3 buildings, `easy`, split `test`:")
    assert documents.refreshed(filled, result) == filled
