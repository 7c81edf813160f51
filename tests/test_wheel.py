"""An installed wheel, outside the repository: a fresh environment in a folder with a space in its name."""

import os
import site
import subprocess
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MOST_BYTES = 5_000_000
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an environment that has the wheel, and for its dependencies the packages of this one."""
    builders = pytest.importorskip("hatchling.builders.wheel")
    folder = tmp_path_factory.mktemp("wheel") / "a folder"
    wheel = Path(next(builders.WheelBuilder(str(ROOT)).build(directory=str(folder), versions=["standard"])))
    assert wheel.stat().st_size < MOST_BYTES
    venv.create(folder / "env", with_pip=True)
    packages = next((folder / "env").glob("lib/python*/site-packages"))
    before = {path.name for path in packages.iterdir()}
    install = [folder / "env/bin/python", "-m", "pip", "install", "-q", "--no-index", "--no-deps", wheel]
    subprocess.run(install, check=True)
    new = {path.name for path in packages.iterdir()} - before
    assert {name for name in new if not name.endswith(".dist-info")} == {"mecp_env"}
    (packages / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    return folder


def call(home: Path, *words: str) -> str:
    """What a command of the wheel prints; nothing is compiled, which would take minutes for a few steps."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    env = {name: value for name, value in os.environ.items() if name not in hidden}
    env |= {"MPLBACKEND": "Agg", "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [home / "env/bin" / words[0], *words[1:]], cwd=home, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_a_demo_of_the_package_of_the_wheel_has_its_replay(home: Path) -> None:
    assert call(home, "python", "-c", "import mecp_env; print(mecp_env.__file__)").startswith(str(home))
    few = ("--config.max-steps", "5", "--config.laser.sweeps", "1", "--config.laser.beams", "180")
    call(home, "mecp-env", "demo", "--layout", "two_rooms", *few, "--out", "my run")
    assert (home / "my run/replay.html").stat().st_size > 10_000
