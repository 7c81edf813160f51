"""The look of the replay page: contrast in both themes, rooms, walls, counts, and nothing that moves as it plays."""

import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mecp_env  # noqa: F401  (registers the environments)
from benchmarks.browser import Browser
from mecp_env.render import palette
from mecp_env.render.replay_page import read_page, write_page
from tests.render.browsing import needs_browser, shown
from tests.render.contrast import contrast, parsed

LEAST_TEXT, LEAST_MARK = 4.5, 3.0  # WCAG 2.1 AA: text, and what is not text
TEXT_ON = (  # colours of text, and what they are written on; names of rooms are on a halo of the panel's colour
    *(("ink", "paper"), ("ink", "panel"), ("faint", "paper"), ("faint", "panel"), ("on-accent", "accent")),
    *(("landmark", "panel"), ("hit", "panel")),
)
MARKS = ("solid", "truth", "estimate", "hit", "landmark", "door", "goal", "place", "mover", "polygon", "quiet")


def sources() -> dict[str, str]:
    folder = files("mecp_env.render") / "player"
    return {name: (folder / name).read_text("utf-8") for name in ("style.css", "player.js", "page.html")}


def themes() -> dict[str, dict[str, str]]:
    """The properties of the style sheet by theme."""
    roots = re.findall(r":root \{(.*?)\}", sources()["style.css"], re.DOTALL)
    light, dark = (dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6,8})", root)) for root in roots)
    assert light.keys() == dark.keys()
    return {"light": light, "dark": dark}


def test_text_and_marks_have_contrast_in_both_themes() -> None:
    for name, inks in themes().items():
        for text, ground in TEXT_ON:
            assert contrast(parsed(inks[text]), parsed(inks[ground])) >= LEAST_TEXT, (name, text, ground)
        for mark in MARKS:
            assert contrast(parsed(inks[mark]), parsed(inks["free"])) >= LEAST_MARK, (name, mark)
        for colour in palette.ROOMS:  # names of rooms, without their halo
            ground = tuple(0.36 * c + 0.64 * f for c, f in zip(colour, parsed(inks["free"]), strict=False))
            assert contrast(parsed(inks["ink"]), ground) >= LEAST_TEXT
    table = re.search(r"const DECISIONS = (\[\[.*?\]\]);", sources()["player.js"])
    assert table is not None
    shapes = re.findall(r'\["\w+", "(\w+)"\]', table[1])
    assert len(set(shapes)) == 4
    assert not set(shapes) & {"star", "hexagon"}  # of goals


CONTRASTS = """(() => {
  const found = [];
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const element = walk.currentNode.parentElement;
    if (!walk.currentNode.textContent.trim() || !element.getClientRects().length || element.closest("script")) continue;
    let ground = element;
    while (getComputedStyle(ground).backgroundColor === "rgba(0, 0, 0, 0)") ground = ground.parentElement;
    const words = walk.currentNode.textContent.trim();
    found.push([words, getComputedStyle(element).color, getComputedStyle(ground).backgroundColor]);
  }
  return found;
})()"""


@needs_browser
def test_text_has_contrast_and_the_maps_follow_a_change_of_the_theme(page: Path) -> None:
    corner = "Array.from(document.getElementById('belief').getContext('2d').getImageData(2, 2, 1, 1).data).slice(0, 3)"
    brightness, before = {}, 0
    with Browser() as browser:
        for theme in ("light", "dark"):
            browser.theme(theme)
            if theme == "light":
                browser.show(page)
            browser.wait(f"Number(document.body?.dataset.drawn) > {before}")
            before, brightness[theme] = browser.ask("Number(document.body.dataset.drawn)"), sum(browser.ask(corner))
            shown = browser.ask(CONTRASTS)
            assert len(shown) > 30
            assert not [row for row in shown if contrast(parsed(row[1]), parsed(row[2])) < LEAST_TEXT]
            grounds = {sum(parsed(row[2])[:3]) for row in shown if row[0].startswith("Space plays")}
            assert (max(grounds) < 150) == (theme == "dark")
    assert brightness["light"] > brightness["dark"] + 200


def drawn(run: dict[str, Any], path: Path, fragment: str = "") -> np.ndarray:
    """(h,w,3) the belief of a run as a browser draws it."""
    write_page(run, path)
    with shown(path, fragment) as browser:
        width, height, data = json.loads(
            browser.ask(
                "(() => { const c = document.getElementById('belief'); return JSON.stringify([c.width, c.height, "
                "Array.from(c.getContext('2d').getImageData(0, 0, c.width, c.height).data)]); })()"
            )
        )
    return np.array(data, np.uint8).reshape(height, width, 4)[:, :, :3]


@needs_browser
def test_polygons_of_a_room_that_overlap_are_no_darker(page: Path, tmp_path: Path) -> None:
    run = read_page(page)
    once = drawn(run, tmp_path / "once.html", "#t=999")
    polygons = run["maps"][-1]["polygons"]
    assert polygons
    run["maps"][-1]["polygons"] = polygons * 6
    other = (np.abs(drawn(run, tmp_path / "often.html", "#t=999").astype(int) - once) > 1).any(axis=2)
    assert other.mean() < 0.02  # smooth edges alone
    run["maps"][-1]["polygons"] = []
    assert (drawn(run, tmp_path / "never.html", "#t=999").astype(int) != once).any(axis=2).mean() > 0.2


@needs_browser
def test_a_slanted_wall_is_a_line_without_teeth(page: Path, tmp_path: Path) -> None:
    run = read_page(page)
    cells = [number for x in range(5, 95) for number in (100 * round(20 + 0.3 * x) + x, 1, 1)]
    empty = {key: [] for key in ("corners", "polygons", "goals", "landmarks", "ranges", "matched", "cells")}
    empty |= {"target": -1, "map": 0, "pose": [300, 200, 0], "truth": None}
    first, second = (frame | empty for frame in run["frames"][:2])
    run |= {"frames": [first | {"cells": cells}, second], "grid": {"origin": [0, 0], "size": [100, 70], "cell": 0.1}}
    run |= {"maps": [{key: [] for key in ("polygons", "doors", "gaps", "rooms")}], "map_in_world": [0, 0, 0]}
    run |= {"walls": [], "solid": [], "opens_at": 0}
    picture = drawn(run, tmp_path / "wall.html")
    solid = np.abs(picture.astype(int) - parsed(themes()["light"]["solid"])[:3]).sum(axis=2) < 40
    across = np.flatnonzero(solid.any(axis=0))
    across = across[len(across) // 10 : -len(across) // 10]
    middle = np.array([np.flatnonzero(solid[:, x]).mean() for x in across])
    cell_px = len(across) / 0.8 / 90.0
    off = middle - np.polyval(np.polyfit(across, middle, 1), across)
    assert np.sqrt((off**2).mean()) < 0.15 * cell_px  # the cells themselves: 0.29
    assert solid[:, across].sum(axis=0).max() < 2.5 * cell_px


@needs_browser
@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_moves_and_counts_are_integers_as_it_plays(page: Path, width: int) -> None:
    with shown(page, width=width) as browser:
        browser.press("Home")
        places, counts = set(), set[str]()
        for _ in range(len(read_page(page)["frames"])):
            places.add(
                browser.ask(
                    "JSON.stringify([...document.querySelectorAll('#slider, #speed, .plot canvas')]"
                    ".map((e) => e.getBoundingClientRect()).map((r) => [r.left, r.top + scrollY, r.width]))"
                )
            )
            counts |= set(
                browser.ask(
                    "[...document.querySelectorAll('.plot')].filter((e) => e.textContent.includes('count'))"
                    ".flatMap((e) => [...e.querySelectorAll('output')].map((o) => o.textContent))"
                )
            )
            browser.press("ArrowRight")
    assert len(places) == 1
    assert len(counts) > 3
    assert all(re.fullmatch(r"\d+", count) for count in counts), counts


@needs_browser
def test_every_curve_has_a_unit_and_the_legend_what_is_drawn(page: Path) -> None:
    ask_titles = "[...document.querySelectorAll('.plot b')].map((e) => e.textContent)"
    with shown(page) as browser:
        titles = browser.ask(ask_titles)
        legend = browser.ask("[...document.querySelectorAll('#legend li')].map((e) => e.textContent)")
        shapes = browser.ask("[...document.querySelectorAll('#legend path')].map((e) => e.outerHTML)")
    units = ("cm", "%", "count", "no unit", "0 to 1", "expected")
    assert len(titles) >= 5
    assert all(any(unit in title for unit in units) for title in titles), titles
    assert len(set(shapes)) == len(shapes)
    frames = read_page(page)["frames"]
    assert any("goal" in words for words in legend)
    for word, name in (("pedestrian", "moving"), ("pose lost", "lost")):
        assert any(word in words for words in legend) == any(frame.get(name) for frame in frames)
    known_ground = any(goal[2] >= 4 for frame in frames for goal in frame.get("goals", []))
    assert ("goal on known ground" in legend) == known_ground
