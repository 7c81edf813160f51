"""Ctrl-C: noted where Python would lose it, and one line instead of a traceback in the process of the command.

Python prints and loses an exception in `__del__` and in a function that C calls, as LLVM's bindings do while a function
is compiled or loaded. It prints a traceback while modules are imported.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

INTERRUPTED = 130  # exit code
PATIENCE_S = 0.02  # after which an interrupt that was lost is sent again

_pressed = list[int]()  # the interrupts of the process of the command


@contextlib.contextmanager
def interrupts_later() -> Iterator[None]:
    """Within it Ctrl-C is noted; this process receives it afterwards."""
    if threading.current_thread() is not threading.main_thread() or not callable(signal.getsignal(signal.SIGINT)):
        yield  # a thread is not interrupted
        return
    noted = list[int]()
    handler = signal.signal(signal.SIGINT, lambda number, _: noted.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        if noted:
            signal.raise_signal(signal.SIGINT)


def is_command(argv: list[str], orig_argv: list[str]) -> bool:
    """True in a process of `mecp-env` or `python -m mecp_env`, also while it imports the package."""
    program = orig_argv[1 : 1 + len(orig_argv) - len(argv)]
    return program[-2:] == ["-m", "mecp_env"] or any(Path(word).stem == "mecp-env" for word in program[-1:])


def watch_interrupts() -> None:
    """From now on, in the process of the command, no interrupt is lost, and what it ends prints one line."""
    unset = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # it is ignored in the background of a shell
    if unset and is_command(sys.argv, sys.orig_argv) and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _interrupt)
        sys.excepthook, sys.unraisablehook = _end, _send_again


def was_interrupted() -> bool:
    """True in the process of the command after an interrupt, also where the exception was caught on its way."""
    return bool(_pressed)


def leave() -> None:
    """The command is over: an interrupt while Python ends its process ends it at once, and prints nothing.

    After an interrupt in `exec`, Python would end itself by that signal and not with our exit code.
    """
    if signal.getsignal(signal.SIGINT) is not _interrupt:
        return
    with contextlib.suppress(OSError, ValueError):  # closed by its reader
        sys.stdout.flush()
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
    if _pressed and hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _interrupt(number: int, frame: FrameType | None) -> None:
    _pressed.append(number)
    raise KeyboardInterrupt


def _end(kind: type[BaseException], error: BaseException, place: TracebackType | None) -> None:
    """Print what ends the process: after an interrupt one line, whatever became of the exception on its way."""
    if not was_interrupted():
        sys.__excepthook__(kind, error, place)
        return
    leave()
    sys.stderr.write("mecp-env: interrupted\n")
    raise SystemExit(INTERRUPTED)


def _send_again(lost: Any) -> None:
    """Print an exception that Python loses; of an interrupt, another one follows."""
    if not issubclass(lost.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    again = threading.Timer(PATIENCE_S, _to_main_thread)
    again.daemon = True
    again.start()


def _to_main_thread() -> None:
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)
