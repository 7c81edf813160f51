"""What `mecp-env slam` prints of the calibration of a robot."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from mecp_env.core.text import sanitised
from mecp_env.evaluation.calibration import Calibration, Estimate

UNITS = {  # of the fields of a calibration; the others have none
    "turn_bias_deg_per_m": "deg per m",
    "x_m": "m",
    "heading_deg": "deg",
    "distance_sigma_m": "m per sqrt(m)",
    "distance_sigma_turning_m": "m per sqrt(rad)",
    "turn_sigma_deg": "deg per sqrt(m)",
    "turn_sigma_turning_deg": "deg per sqrt(rad)",
    "range_sigma_m": "m",
}
COLUMNS = {"field": "left", "value": "right", "sigma": "right", "unit": "left", "source": "left"}


def print_calibration(calibration: Calibration | None) -> None:
    """Print each value with its standard deviation and source, and why defaults are used; nothing without one."""
    if calibration is None:
        return
    title = f"calibration by {calibration.registered} of {calibration.tried} motions between scans"
    table = Table(title=title, title_justify="left")
    for column, side in COLUMNS.items():
        table.add_column(column, justify="right" if side == "right" else "left")
    for name, estimate in calibration.estimates.items():
        table.add_row(*_row(name, estimate))
    if calibration.range_noise_m is not None:
        table.add_row("range noise on straight walls", f"{calibration.range_noise_m:.4f}", "", "m", "measured")
    console = Console()
    console.print(table)
    for note in calibration.notes:
        console.print(f"note: {sanitised(note)}", markup=False)


def _row(name: str, estimate: Estimate) -> tuple[str, str, str, str, str]:
    sigma = "" if estimate.sigma is None else f"{estimate.sigma:.4f}"
    return name, f"{estimate.value:.4f}", sigma, UNITS.get(name, ""), estimate.source
