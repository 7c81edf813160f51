"""Golden hashes of whole runs: `python -m tests.golden` prints them, `--write` stores them for this machine type.

The promise is "the same bits for one version on one machine type": sin, cos and atan2 of the C library differ between
processors with and without fused multiply-add, so the hashes are keyed on a probe of them.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from pathlib import Path

import gymnasium
import numpy as np

import mecp_env  # noqa: F401  (registers the environments)
from mecp_env.config import EnvConfig

STORE = Path(__file__).parent / "data" / "golden.json"
CASES = {
    "paper_map": ("mecp_env/PaperMap-v0", {}),
    "two_rooms_lms200": ("mecp_env/Layout-v0", {"layout": "two_rooms", "laser": {"preset": "lms200", "sweeps": 1}}),
    "paper_to_the_letter": ("mecp_env/Layout-v0", {"config": EnvConfig.paper().to_dict(), "layout": "two_rooms"}),
}
PERIODS = 150


def probe() -> str:
    """What this machine's C library and NumPy's own vector code make of a few thousand angles, in short."""
    angles = np.linspace(-7.0, 7.0, 4001)
    values = [f(a) for a in angles for f in (math.sin, math.cos, math.tan)] + [math.atan2(a, 0.3) for a in angles]
    vector = [f(angles) for f in (np.sin, np.cos, np.exp, np.arctan)] + [np.arctan2(angles, 0.3), np.hypot(angles, 0.3)]
    return hashlib.sha256(np.array(values).tobytes() + np.array(vector).tobytes()).hexdigest()[:16]


def run_hash(case: str) -> str:
    """sha256 over belief, observation and reward of every period of a scripted drive."""
    env_id, keywords = CASES[case]
    env = gymnasium.make(env_id, **keywords)
    digest = hashlib.sha256()
    _feed(digest, env.reset(seed=7)[0])
    for period in range(PERIODS):
        turn = 0.4 * math.sin(0.05 * period)
        observation, reward, terminated, truncated, info = env.step(np.array([0.6, turn], np.float32))
        _feed(digest, observation | {"reward": np.float64(reward), "truth": info["truth_pose"]})
        if terminated or truncated:
            _feed(digest, env.reset()[0])
    return digest.hexdigest()


def _feed(digest: hashlib._Hash, arrays: dict[str, np.ndarray]) -> None:
    for name in sorted(arrays):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())


def stored() -> dict[str, dict[str, str]]:
    """Hashes by probe, then case."""
    return json.loads(STORE.read_text()) if STORE.is_file() else {}


def main() -> None:
    """Print the hashes of this machine; store them with `--write`."""
    hashes = {case: run_hash(case) for case in CASES}
    print(json.dumps({probe(): hashes}, indent=1))
    if "--write" in sys.argv:
        STORE.write_text(json.dumps(stored() | {probe(): hashes}, indent=1, sort_keys=True) + "\n")


if __name__ == "__main__":
    main()
