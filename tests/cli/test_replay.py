"""`mecp-env replay`."""

from pathlib import Path

import pytest

from mecp_env.cli.main import main
from mecp_env.render.replay_page import read_page

pytestmark = pytest.mark.usefixtures("draft_figures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kept = tmp_path_factory.mktemp("run") / "kept"
    assert main(["demo", "--layout", "two_rooms", "--config.max-steps", "20", "--out", str(kept)]) == 0
    return kept


def test_a_page_gets_the_player_of_this_version(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "replay.html").read_text()
    (folder / "replay.html").write_text(before.replace("Pause", "Halt"))
    assert main(["replay", str(folder)]) == 0
    assert (folder / "replay.html").read_text() == before
    assert f"21 frames: {folder / 'replay.html'}" in capsys.readouterr().out


def test_a_run_without_a_page_is_explored_again(folder: Path, tmp_path: Path) -> None:
    wanted = read_page(folder / "replay.html")
    (folder / "replay.html").rename(tmp_path / "page.html")
    try:
        assert main(["replay", str(folder), "--out", str(tmp_path / "again.html")]) == 0
    finally:
        (tmp_path / "page.html").rename(folder / "replay.html")
    assert read_page(tmp_path / "again.html") == wanted
