"""Files of any name are written, and text in any encoding read."""

from pathlib import Path

import pytest

from mecp_env.core.files import text_of, write_atomic


def test_a_name_as_long_as_the_system_allows_is_written(tmp_path: Path) -> None:
    name = "ü" * 120 + ".json"
    write_atomic(tmp_path / name, b"whole")
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be"])
def test_text_as_editors_and_shells_save_it(encoding: str) -> None:
    mark = "\ufeff" if encoding == "utf-16-be" else ""
    assert text_of((mark + '{"name": "Küche"}').encode(encoding)) == '{"name": "Küche"}'
