"""The replay: what is kept of a run, the page, and how a real browser plays it."""

import base64
import gzip
import html
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.browser import Browser
from mecp_env.core.errors import ConfigError
from mecp_env.render import replay
from mecp_env.render.replay import Recorder, ReplayError, read_page, write_page
from mecp_env.render.replay_page import PackedGrid, changed_cells
from mecp_env.wrappers import RecordReplay
from tests.render.browsing import needs_browser, shown

CLOCK = "document.getElementById('clock').textContent"


def cells_at_the_end(run: dict[str, Any]) -> np.ndarray:
    """(H*W,) the map of the last frame."""
    cells = np.zeros(run["grid"]["size"][::-1], np.uint8).ravel()
    for frame in run["frames"]:
        for first, count, code in np.reshape(frame.get("cells", []), (-1, 3)).astype(int).tolist():
            cells[first : first + count] = code
    return cells


def test_a_page_has_every_step_and_the_last_belief(kept: tuple[Path, list[Any]]) -> None:
    page, views = kept
    run = read_page(page)
    assert page.stat().st_size < 200_000
    assert [frame["step"] for frame in run["frames"]] == list(range(len(views) + 1))
    landmarks: dict[int, list[int]] = {}
    for frame in run["frames"]:
        for name, *row in frame.get("landmarks", []):
            landmarks.pop(name, None) if not row else landmarks.update({name: row})
    output = views[-1].slam_output
    assert sorted(landmarks) == sorted(output.belief.ids.tolist())
    placed = np.array([landmarks[name][:2] for name in output.belief.ids.tolist()])
    np.testing.assert_allclose(placed / 100.0, output.belief.p_map, atol=0.00501)
    assert (cells_at_the_end(run) > 0).sum() == (output.grid.label > 0).sum()
    assert run["frames"][-1]["curves"]["coverage"] == round(1e4 * views[-1].metrics["coverage"])
    assert "reward_area" in run["curve_units"]


def test_corners_and_polygons_say_what_was_decided_and_why(kept: tuple[Path, list[Any]]) -> None:
    """The vertices that are said to be recognised are landmarks, or tracks, of corners of the chosen polygon."""
    page, views = kept
    run = read_page(page)
    for view, frame in zip(views, run["frames"][1:], strict=True):
        output, rows = view.slam_output, frame.get("corners", [])
        assert [row[7] for row in rows] == output.match.decision.tolist()
        assert [row[9] for row in rows] == output.match.ids.tolist()
        assert all(run["reasons"][str(row[8])] for row in rows)
        if frame.get("matched"):
            vertices = output.polygons[output.associated.polygon].corners
            assert set(output.associated.ids[vertices].tolist()) <= {-1, *frame["matched"]}
    assert any(frame.get("matched") for frame in run["frames"])


def test_a_long_run_keeps_evenly_spaced_steps(kept: tuple[Path, list[Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "MOST_FRAMES", 8)
    some = Recorder(0.4)
    for view in kept[1][:30]:
        some.look(view)
    run = some.run("thin")
    assert len(run["frames"]) <= 8
    assert set(np.diff([frame["step"] for frame in run["frames"]])) == {some.every}
    assert run["frames"][1]["time"] == round(40 * some.every)
    assert (cells_at_the_end(run) > 0).sum() == (some.frames[-1].grid.codes > 0).sum()


def test_a_grid_that_grows_keeps_its_place() -> None:
    small, large = np.array([[1, 3]], np.uint8), np.array([[0, 0, 0], [0, 1, 3]], np.uint8)
    grids = [PackedGrid.of(small, np.zeros(2)), PackedGrid.of(large, np.array([-0.1, -0.1]))]
    place, size, runs = changed_cells(grids, 0.1)
    np.testing.assert_allclose(place, [-0.1, -0.1])
    assert (size, runs) == ([3, 2], [[4, 1, 1, 5, 1, 3], []])


def packed(raw: bytes) -> str:
    data = base64.b64encode(gzip.compress(raw)).decode()
    return f'<script id="run" type="text/plain" data-version="1">{data}</script>'


def damaged(text: str) -> str:
    middle = text.index('data-version="1">') + 200
    return text[:middle] + "AAAA" + text[middle + 4 :]


def test_a_page_that_is_none_is_refused(page: Path, tmp_path: Path) -> None:
    text, runs = page.read_text(), [b'{"frames":[1]}', b'{"frames":[1],"title":5}', b'{"frames":1,"title":"x"}']
    runs += [b"[" * 300_000, b" " * 200_000_000, b'{"title":"x","frames":[' + b"[]," * 3_000_000 + b"[]]}"]
    for wrong, words in (
        (text[: len(text) // 3], "part of it is missing"),
        ("<html></html>", "no replay"),
        (text.replace('data-version="1"', 'data-version="2"'), "version 2 of the .* reads up to 1"),
        (damaged(text), "damaged"),
        *((packed(run), "") for run in runs),
    ):
        (tmp_path / "p.html").write_text(wrong)
        with pytest.raises(ReplayError, match=rf"p\.html.*{words}"):
            read_page(tmp_path / "p.html")


def test_a_title_stays_as_it_is_and_cannot_break_the_page(tmp_path: Path) -> None:
    title = r"{{player}}{{run}}{{style}}{{version}}{{title}} \1 \g<0> <script>x</script>"
    write_page({"frames": [1], "title": title}, tmp_path / "p.html")
    assert f'<h1 id="title">{html.escape(title)}</h1>' in (tmp_path / "p.html").read_text()
    assert "<script>x" not in (tmp_path / "p.html").read_text()
    assert read_page(tmp_path / "p.html")["title"] == title


def test_an_environment_with_velocities_is_recorded_too(tmp_path: Path) -> None:
    env = RecordReplay(gym.make("mecp_env/Layout-v0", layout="two_rooms", disable_env_checker=True), tmp_path, every=2)
    for _ in range(3):
        env.reset(seed=0)
        for _ in range(4):
            env.step(np.array([0.5, 0.2], np.float32))
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["episode-0000.html", "episode-0002.html"]
    assert len(read_page(tmp_path / "episode-0002.html")["frames"]) == 5
    with pytest.raises(ConfigError, match="expected a mecp_env environment"):
        RecordReplay(gym.make("CartPole-v1"), tmp_path)


@needs_browser
@pytest.mark.parametrize("width", [1280, 390])
def test_a_browser_plays_it_without_complaint(kept: tuple[Path, list[Any]], width: int, tmp_path: Path) -> None:
    with shown(kept[0], "#t=2", width=width) as browser:
        assert browser.ask(CLOCK).startswith("2.0 s, step 5 of")
        browser.press("ArrowRight")
        assert browser.ask(CLOCK).startswith("2.4 s, step 6 of")
        browser.press("End")
        assert f"step {len(kept[1])} of {len(kept[1])}" in browser.ask(CLOCK)
        browser.press("Home")
        before = browser.ask("Number(document.body.dataset.drawn)")
        browser.press(" ")
        browser.wait(f"Number(document.body.dataset.drawn) > {before + 2}")
        assert browser.ask("document.documentElement.scrollWidth") <= width
        browser.picture(tmp_path / "page.png")
        assert browser.logged == []


@pytest.mark.slow
@needs_browser
def test_the_pointer_tells_why(kept: tuple[Path, list[Any]]) -> None:
    run = read_page(kept[0])
    with shown(kept[0]) as browser:
        box = browser.ask("JSON.parse(JSON.stringify(document.getElementById('belief').getBoundingClientRect()))")
        spots = [(x, y) for x in range(10, int(box["width"]), 20) for y in range(10, int(box["height"]), 20)]
        said = set()
        for x, y in spots:
            browser.move(box["left"] + x, box["top"] + y)
            said.add(browser.ask("document.getElementById('tip').textContent"))
        reasons = set(run["reasons"].values())
        assert any(words.partition(" - ")[2].partition(";")[0] in reasons for words in said)
    assert run["opens_at"] > 0


@needs_browser
def test_a_browser_that_cannot_play_it_says_so(kept: tuple[Path, list[Any]], tmp_path: Path) -> None:
    spoilt = tmp_path / "page.html"
    spoilt.write_text(damaged(kept[0].read_text()))
    for script, page, words in (
        ("HTMLCanvasElement.prototype.getContext = undefined", kept[0], "cannot draw (no canvas)"),
        ("delete window.DecompressionStream", kept[0], "cannot unpack the run"),
        ("0", spoilt, "cannot be played"),
    ):
        with Browser() as browser:
            browser.before_pages(script)
            browser.show(page)
            browser.wait(f"document.getElementById('trouble')?.textContent.includes({words!r})")
