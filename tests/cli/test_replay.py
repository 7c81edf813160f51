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


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "there is no such file or folder"),
        (lambda path: path.mkdir(), "neither replay.html nor a config.json"),
        (lambda path: path.write_text("hello"), "no replay of mecp_env"),
        (
            lambda path: (path.mkdir(), (path / "config.json").write_text('{"log": "x.log"}')),
            "no run of `mecp-env demo`",
        ),
    ],
)
def test_what_is_no_run_is_refused(make, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "run")
    assert main(["replay", str(tmp_path / "run")]) == 2
    assert words in capsys.readouterr().err
