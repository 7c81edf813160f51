"""The benchmark of the formats: figures of each format, rows, tables."""

from benchmarks import formats


def test_every_offered_row_is_described() -> None:
    rows = formats.rows_described("PaperMap", 1)
    assert rows["described"]["value"] == 1.0
    assert rows["decisions"] > 1
    assert rows["described"]["n"] == round(rows["offered"] * rows["decisions"])
