"""The option `--save-map`: the map that the robot made, in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mecp_env.cli.base import check_writable
from mecp_env.cli.buildings import spare_sources
from mecp_env.cli.exit_codes import echo, print_error
from mecp_env.core.errors import ConfigError, MecpError
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


def save_map(owner: Any, path: Path | None) -> bool:
    """Write the map of a `MecpEnv` or `SlamPipeline`, if it is wanted, and print where it is.

    False where it cannot be written: the reason is printed, and the run keeps everything else.
    """
    if path is None:
        return True
    try:
        owner.save_map(path)
    except MecpError as error:
        print_error(f"--save-map: {path} was not written: {error}")
        return False
    except OSError as error:
        print_error(f"--save-map: {path} was not written: {error.strerror}")
        return False
    echo(f"map: {path}")
    return True
