"""How the commands of `agents` end: what was wrong in one line, no traceback of what a user caused."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import gymnasium as gym

from mecp_env.core.errors import MecpError
from mecp_env.core.text import readable

FAILED, WRONG_INPUT, INTERRUPTED = 1, 2, 130  # exit codes beside 0


def ended(name: str, command: Callable[[], int]) -> int:
    """What `command` returns; 2 for wrong input or a file that fails, said on stderr, or 130 after Ctrl-C.

    It is 0 when nobody reads the output any more, as in `python -m mecp_env.policies.nearest | head -1`.
    """
    try:
        return command()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (MecpError, gym.error.Error) as error:
        complain(name, error)
        return WRONG_INPUT
    except OSError as error:
        complain(name, f"{error.filename or 'output'}: {error.strerror}")
        return WRONG_INPUT
    except KeyboardInterrupt:
        complain(name, "interrupted")
        return INTERRUPTED


def complain(name: str, what: object) -> None:
    """Say on stderr what is wrong, after the name of the command; lines stay lines."""
    print(f"{name}:", lines(what), file=sys.stderr)


def say(what: object) -> None:
    """Print what may hold names from files of strangers; lines stay lines."""
    print(lines(what))


def lines(what: object) -> str:
    """`what` as text without signs that a terminal would obey, but for the ends of its lines."""
    return "\n".join(map(readable, str(what).split("\n")))
