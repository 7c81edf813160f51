"""Run a command and print, as JSON, the CPU and wall seconds of it and of every process that it started.

Usage: `python cpu_cost.py COMMAND...`. On Linux, processes that outlive the command are waited for and counted too.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import resource
import subprocess
import sys
import time

SET_CHILD_SUBREAPER = 36  # prctl: orphans among the descendants become children of this process

if sys.platform == "linux":
    ctypes.CDLL(None).prctl(SET_CHILD_SUBREAPER, 1, 0, 0, 0)
start = time.perf_counter()
code = subprocess.run(sys.argv[1:], stdout=sys.stderr, check=False).returncode
wall = time.perf_counter() - start
with contextlib.suppress(ChildProcessError):
    while True:
        os.waitpid(-1, 0)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps({"code": code, "cpu_s": used.ru_utime + used.ru_stime, "wall_s": wall}))
