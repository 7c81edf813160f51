"""Every program of docs/your-library.md runs as it is printed, where its library is installed."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

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


def test_the_page_names_each_library_and_its_programs_are_short() -> None:
    code = "\n".join(PROGRAMS.values())
    assert [name for name in LIBRARIES if name not in code] == []
    assert all(len(program.splitlines()) <= 22 for program in PROGRAMS.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_each_program_runs(name: str, tmp_path: Path) -> None:
    for library in LIBRARIES:
        if library in PROGRAMS[name]:
            pytest.importorskip(library)
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    (tmp_path / "program.py").write_text(PROGRAMS[name])
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "program.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    assert name not in FILES or (tmp_path / FILES[name]).exists()
