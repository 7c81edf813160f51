"""Train an agent: `python -m mecp_env.learning.train ALGO [options]`; `--help` lists every option."""

from __future__ import annotations

import multiprocessing
import signal
import sys
from contextlib import closing
from multiprocessing import forkserver
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # imports take seconds; here nothing would catch a Ctrl-C that comes in them
    from mecp_env.learning.line import Order
    from mecp_env.learning.run_folder import RunFolder
    from mecp_env.learning.trainer import Trainer

FAILED, WRONG_INPUT, INTERRUPTED = 1, 2, 130
ENDS = {0: "done", FAILED: "failed, saved up to the last checkpoint", INTERRUPTED: "stopped"}
INSTALL = 'pip install -e ".[rl]" (PyTorch first, see the README)'


def main(words: list[str]) -> int:
    """Train; the exit code: 0, 2 for wrong input, 130 after Ctrl-C.

    It is 1 when a worker died, a weight is no number any more, or the disk is full.
    """
    try:
        return attempt(words)
    except KeyboardInterrupt:
        print("train: interrupted", file=sys.stderr)
        return INTERRUPTED


def attempt(words: list[str]) -> int:
    """As `main`; what is wrong is said on stderr. Raises `KeyboardInterrupt` outside the training itself."""
    from mecp_env.core.errors import MecpError
    from mecp_env.core.exit_codes import complain
    from mecp_env.vector import WorkerDied

    try:
        from mecp_env.learning.line import parse
        from mecp_env.learning.output import enduring_output

        with enduring_output():
            return train(parse(words))
    except MecpError as error:
        complain("train", error)
    except ModuleNotFoundError as error:
        print(f"train: needs {error.name}: {INSTALL}", file=sys.stderr)
    except WorkerDied as error:
        complain("train", error)
        return FAILED
    except OSError as error:
        print(f"train: {error.filename or 'files'}: {error.strerror}", file=sys.stderr)
        return FAILED
    return WRONG_INPUT


def workers_leave_ctrl_c() -> None:
    """Have the process that starts workers ignore Ctrl-C: each of them then does from its first moment on."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        forkserver.ensure_running()
    finally:
        signal.signal(signal.SIGINT, before)


def train(order: Order) -> int:
    """Begin a run, or go on with one; the exit code. Raises `ConfigError`."""
    from mecp_env.learning.environments import make_env
    from mecp_env.learning.models import check_size
    from mecp_env.learning.run_folder import RunFolder
    from mecp_env.learning.warm_start import check_teacher

    check_teacher(order.config)
    check_size(order.config)
    for index in range(len(order.config.buildings.difficulty)):  # what is wrong is said before anything is written
        make_env(order.config, index).close()
    with closing(RunFolder(order.folder, order.config)) as folder:
        folder.take_up() if order.resume else folder.begin()
        code = train_in(folder, order)
    print(f"{ENDS[code]}: {order.folder}")
    if code:
        print(f"go on with: python -m mecp_env.learning.train --resume {order.folder}")
    return code


def train_in(folder: RunFolder, order: Order) -> int:
    """Train in a folder that is held; the exit code."""
    from mecp_env.learning.report import Report
    from mecp_env.learning.trainer import Trainer

    if "forkserver" in multiprocessing.get_all_start_methods():
        workers_leave_ctrl_c()
    report = Report(order.folder, order.config)
    with Trainer(folder, report) as trainer, report:  # workers are forked only where no thread runs yet
        if order.resume:
            go_on(trainer)
        return run(trainer)


def go_on(trainer: Trainer) -> None:
    """Take up a run again."""
    trainer.folder.keep_config()
    trainer.folder.note("resumed")
    found = trainer.resume()
    where = f"after {trainer.progress.decisions:,} decisions" if found else "from the beginning: no checkpoint yet"
    trainer.report.say(f"resumed {where}")


def run(trainer: Trainer) -> int:
    """Train until the end, Ctrl-C, the death of a worker, or weights that are no numbers; the exit code."""
    from mecp_env.learning.files import NotFiniteError
    from mecp_env.vector import WorkerDied

    stop_on_interrupt(trainer)
    try:
        trainer.run()
    except (WorkerDied, NotFiniteError) as error:
        trainer.report.say(f"train: {error}")
        return FAILED
    return INTERRUPTED if trainer.stop else 0


def stop_on_interrupt(trainer: Trainer) -> None:
    """Let the first Ctrl-C end the run in order, a second one at once."""

    def stop(number: int, frame: Any) -> None:
        trainer.stop = True
        trainer.report.say("stopping: what is running is finished and saved; Ctrl-C again ends at once")
        signal.signal(signal.SIGINT, signal.default_int_handler)

    signal.signal(signal.SIGINT, stop)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
