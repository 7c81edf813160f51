"""Measurements with a command each: `python -m benchmarks NAME [--json FILE] [--jobs N] [--gate] [--quick]`."""
