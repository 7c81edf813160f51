"""The option `--save-map`: the map that the robot made, in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mecp_env.cli.base import check_writable
from mecp_env.cli.buildings import spare_sources
from mecp_env.cli.exit_codes import echo
from mecp_env.core.errors import ConfigError
from mecp_env.core.paths import exists


def check_map(path: Path | None, layout: str, estimator: str) -> None:
    """Raise `ConfigError` where the map of a run cannot be written or would be of no use; None: no map is wanted.

    A map of this version is replaced, any other file is not.
    """
    if path is None:
        return
    spare_sources([check_writable(path, "--save-map")], [layout])
    if exists(path):
        replaceable(path)
    if estimator == "known":
        raise ConfigError(f"--save-map: {path}: a map of the estimator 'known' localises with ground truth only")


def replaceable(path: Path) -> None:
    """Raise `ConfigError` unless a file is a map of this version."""
    from mecp_env.slam.map_file import MapError, SlamMap  # compiled functions are loaded only where a map is read

    try:
        SlamMap.load(path)
    except MapError as error:
        raise ConfigError(f"--save-map: {error}; name another file") from None


def save_map(env: Any, path: Path | None) -> None:
    """Write the map of the estimator of a `MecpEnv`, if it is wanted, and print where it is."""
    if path is not None:
        env.save_map(path)
        echo(f"map: {path}")
