"""The option `--rerun`: the run as a recording of the rerun viewer."""

from __future__ import annotations

from pathlib import Path

from mecp_env.cli.base import check_writable
from mecp_env.cli.exit_codes import echo
from mecp_env.core.errors import ConfigError
from mecp_env.render.rerun_log import RerunLog, rerun_library

SUFFIX = ".rrd"


def rerun_log(path: Path | None, period_s: float = 0.4) -> RerunLog | None:
    """The recording at `path`; None where none is wanted. Raises `ConfigError` where it cannot be written."""
    if path is None:
        return None
    if path.suffix != SUFFIX:
        raise ConfigError(f"--rerun: {path}: expected a file name that ends in {SUFFIX}")
    try:
        rerun_library()
        return RerunLog(check_writable(path, "--rerun"), period_s)
    except (ConfigError, OSError) as error:
        raise ConfigError(f"{'' if '--rerun' in str(error) else '--rerun: '}{error}") from None


def end_rerun(log: RerunLog | None, path: Path | None) -> None:
    """End the file, and print where it is."""
    if log is not None:
        log.close()
        echo(f"recording: {path} (rerun {path})")
