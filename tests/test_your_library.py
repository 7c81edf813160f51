"""Every program of docs/your-library.md runs as it is printed, where its library is installed."""

import os
import re
from pathlib import Path

import pytest

from tests.launcher import Launcher

ROOT = Path(__file__).parent.parent
LIBRARIES = ("stable_baselines3", "sb3_contrib", "torch", "torchrl", "ray.rllib", "pufferlib", "skrl")
PAGE = (ROOT / "docs/your-library.md").read_text()
SECTIONS = re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
PROGRAMS = {
    f"{title} {number}": code
    for title, text in SECTIONS
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", text, re.DOTALL), 1)
}
NEEDS = {"A film 1": "moviepy"}
FILES = {"PPO (Stable-Baselines3) 1": "ppo_first.zip", "A film 1": "films/first-episode-0.mp4"}


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_each_program_runs(launcher: Launcher, name: str, tmp_path: Path) -> None:
    for library in LIBRARIES:
        if library in PROGRAMS[name]:
            pytest.importorskip(library)
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    done = launcher.start(PROGRAMS[name], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)})
    printed, _ = done.communicate()
    assert done.returncode == 0, printed
    assert name not in FILES or (tmp_path / FILES[name]).exists()
