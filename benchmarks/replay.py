"""The replay of the demo: its size, the time to the first frame, and the frames per second, in headless Chromium.

The run is that of `mecp-env demo`. The first frame is timed from the command to open the page, a fresh browser each
time; frames are counted for three seconds of playing at 30 times real time, 1280 pixels wide, drawn by the processor.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from benchmarks.browser import Browser, chromium
from benchmarks.common import Figures, OptionError, Options, estimate
from mecp_env.cli.runs import Run
from mecp_env.config import EnvConfig
from mecp_env.env import MecpEnv
from mecp_env.render.replay_page import write_page

RUNS, QUICK_RUNS = 10, 2
PLAYED_S = 3.0
DRAWN = "Number(document.body?.dataset.drawn)"


def run(options: Options) -> Figures:
    """Figures of one page over several browsers. Raises `OptionError` without a browser."""
    if chromium() is None:
        raise OptionError("replay: no Chromium on this machine; Debian has it as the package `chromium`")
    explored = Run(MecpEnv(EnvConfig.build(layout="paper")), 0)
    explored.explore()
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "replay.html"
        write_page(explored.replay(), page)
        shown = [show(page) for _ in range(QUICK_RUNS if options.quick else RUNS)]
        size = page.stat().st_size
    first, rate = zip(*shown, strict=True)
    steps = {"steps": len(explored.moments), "page_kb": size / 1e3}
    return steps | {"first_frame_s": estimate(first), "frames_per_s": estimate(rate)}


def show(page: Path) -> tuple[float, float]:
    """Seconds to the first frame, and frames per second while the page plays."""
    with Browser() as browser:
        start = time.monotonic()
        browser.show(page)
        browser.wait(f"{DRAWN} > 0")
        first = time.monotonic() - start
        browser.ask("document.getElementById('speed').value = '30'")
        browser.press("Home")
        drawn, start = browser.ask(DRAWN), time.monotonic()
        browser.press(" ")
        time.sleep(PLAYED_S)
        return first, (browser.ask(DRAWN) - drawn) / (time.monotonic() - start)
