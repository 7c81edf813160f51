"""Train an agent: `python -m agents.train ALGO [options]`; `--help` lists every option. docs/training.md tells more."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from agents.learning.line import Order, parse
from mecp_env.errors import MecpError

if TYPE_CHECKING:
    from agents.learning.trainer import Trainer

WRONG_INPUT, INTERRUPTED = 2, 130
INSTALL = 'pip install -e ".[rl]" (PyTorch first, see the README)'


def main(words: list[str]) -> int:
    """Train; exit code 0, 2 for wrong input, 130 after Ctrl-C."""
    try:
        return train(parse(words))
    except MecpError as error:
        print(f"train: {error}", file=sys.stderr)
    except ModuleNotFoundError as error:
        print(f"train: needs {error.name}: {INSTALL}", file=sys.stderr)
    return WRONG_INPUT


def train(order: Order) -> int:
    """Begin a run, or go on with one. Raises `ConfigError`."""
    from agents.learning.environments import make_env
    from agents.learning.report import Report
    from agents.learning.run_folder import RunFolder
    from agents.learning.trainer import Trainer
    from agents.learning.warm_start import check_teacher

    check_teacher(order.config)
    make_env(order.config).close()  # what is wrong with the environment is said before anything is written
    folder = RunFolder(order.folder, order.config)
    if not order.resume:
        folder.begin()
    with Report(order.folder, order.config) as report, Trainer(folder, report) as trainer:
        if order.resume:
            go_on(trainer)
        interrupted = stopping(trainer)
        trainer.run()
    print(f"{'stopped, saved' if interrupted() else 'done'}: {order.folder}")
    if interrupted():
        print(f"go on with: python -m agents.train --resume {order.folder}")
    return INTERRUPTED if interrupted() else 0


def go_on(trainer: Trainer) -> None:
    """Take up a run again."""
    trainer.folder.keep_config()
    trainer.folder.note("resumed")
    found = trainer.resume()
    where = f"after {trainer.progress.decisions:,} decisions" if found else "from the beginning: no checkpoint yet"
    trainer.report.say(f"resumed {where}")


def stopping(trainer: Trainer) -> Callable[[], bool]:
    """Let the first Ctrl-C end the run in order, a second one at once; what comes back tells whether there was one."""

    def stop(number: int, frame: Any) -> None:
        trainer.stop = True
        trainer.report.say("stopping: what is running is finished and saved; Ctrl-C again ends at once")
        signal.signal(signal.SIGINT, signal.default_int_handler)

    signal.signal(signal.SIGINT, stop)
    return lambda: trainer.stop


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
