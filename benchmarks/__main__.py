"""The command of the benchmarks: run one, write or compare its figures; the same command continues after a kill."""

from __future__ import annotations

import argparse
import importlib
import json
import shutil
import signal
import sys
from collections.abc import Iterator
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from benchmarks import common
from benchmarks.common import Figures, OptionError, Options, ShardDone, page_of
from mecp_env.cli.base import check_json
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.interrupts import INTERRUPTED
from mecp_env.core.provenance import import_modules
from mecp_env.core.work_units import WHOLE, Shard
from mecp_env.render.figures import save as save_figure

NAMES = (
    *("ablation", "association", "association_time", "claims", "clutter", "consistency", "explorers", "features"),
    *("figures", "filters", "formats", "kidnap", "learning", "loop", "map_size", "mutated", "noise", "paper_mode"),
    *("real", "replay", "restore", "returns", "scale", "sensors", "soak", "speed", "start", "stock_ppo"),
    *("structures", "uncertainty", "vector", "vector_step", "victoria_park", "worlds"),
)
HERE_ONLY = ("association_time", "map_size", "real", "scale", "soak")  # times, memory, maps: none runs on a cluster
IN_ONE = ("figures", "formats", "learning", "replay", "speed", "start", "stock_ppo")
IN_ONE += ("vector", "vector_step", "victoria_park")
IN_UNITS = tuple(name for name in NAMES if name not in IN_ONE)  # of work, kept and divided
HAVING = {  # an option that not all benchmarks have -> those that have it
    "against": ("speed", "start"),
    "buildings": ("returns", "uncertainty"),
    "cluster": tuple(name for name in IN_UNITS if name not in HERE_ONLY),
    "policies": ("returns", "uncertainty"),
    "records": (
        *("ablation", "association", "association_time", "claims", "clutter", "consistency", "figures", "kidnap"),
        *("loop", "map_size", "noise", "paper_mode", "real", "sensors", "structures"),
    ),
    "shard": IN_UNITS,
    "task": ("uncertainty",),
    "with": (
        *("association", "clutter", "consistency", "filters", "loop", "map_size", "noise", "structures"),
        "victoria_park",
    ),
}
COLOURS = 128  # of a committed picture: lines and areas need no more


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0, or 1 where a gate or a bound failed, or 2 for a wrong command line."""
    command = parser()
    given = command.parse_args(arguments)
    module = importlib.import_module(f"benchmarks.{given.name}")
    try:
        options = options_of(given, module)
        import_modules(given.modules)
    except ConfigError as error:
        command.error(str(error))
    if options.against and given.name == "speed":
        module = importlib.import_module("benchmarks.against")
    try:
        content = measure(given.name, module, options)
    except OptionError as error:
        command.error(str(error))
    except MecpError as error:
        print(f"python -m benchmarks: {error}", file=sys.stderr)
        return 1
    except ShardDone as done:
        print(f"{done}; after all shards, the same command without --shard gives the figures")
        return 0
    print(page_of(content, module))
    code = gate(content) if given.gate else keep(given, module, options, content)
    shutil.rmtree(options.folder, ignore_errors=True)  # another run measures again
    return code


def keep(given: argparse.Namespace, module: Any, options: Options, content: Figures) -> int:
    """Write the result, unless it is a part and no file is named for it; 1 where a bound of the benchmark failed."""
    is_part = given.quick or given.sets or given.modules or given.against
    if given.json or not is_part:
        path = given.json or common.RESULTS / f"{given.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content, indent=2) + "\n")
        path.with_suffix(".md").write_text(page_of(content, module, f"{path.stem}.png"))
        if hasattr(module, "figure"):
            save_figure(module.figure(content["figures"]), path.with_suffix(".png"))
        if hasattr(module, "pictures"):
            save_pictures(module.pictures(options), path.with_suffix(""))
    faults = module.faults(content["figures"]) if hasattr(module, "faults") else []
    sys.stderr.writelines(f"failed: {fault}\n" for fault in faults)
    return 1 if faults else 0


def save_pictures(pictures: dict[str, Figure], folder: Path) -> None:
    """Write each picture into the folder as PNG and SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        save_figure(picture, folder / f"{name}.png", dpi=200)
        with Image.open(folder / f"{name}.png") as drawn:
            few = drawn.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(folder / f"{name}.png", optimize=True)
        with rc_context({"svg.fonttype": "none"}):
            save_figure(picture, folder / f"{name}.svg", dpi=200)


def options_of(given: argparse.Namespace, module: Any) -> Options:
    """The options of a benchmark. Raises `ConfigError` for one that is wrong, or that the benchmark does not have."""
    for fault in wrong_options(given, module):
        raise OptionError(fault)
    if given.json:
        check_json(given.json, "json")
    folder = common.UNITS / given.name
    shared = {field.name: getattr(given, field.name) for field in fields(Options) if hasattr(given, field.name)}
    places = {"folder": folder.absolute(), "records": (given.records or folder / "records").absolute()}
    return Options(**shared | places | {"shard": Shard.parse(given.shard)})


def wrong_options(given: argparse.Namespace, module: Any) -> Iterator[str]:
    """What is wrong with the options that only some benchmarks have, and with the places that files are written to."""
    asked = vars(given) | {"with": given.modules, "shard": given.shard != str(WHOLE)}
    for option, names in HAVING.items():
        if asked[option] and given.name not in names:
            yield f"--{option}: {given.name} does not have it; {', '.join(names)} do"
    if given.sets and not hasattr(module, "SETS"):
        yield f"--sets: {given.name} is measured whole"
    part = [option for option in ("against", "quick", "sets") if asked[option] and given.gate]
    yield from (f"--{option}: not with --gate, which compares the whole" for option in part)
    too_few = {"jobs": given.jobs < 1, "buildings": given.buildings < 0}
    yield from (f"--{option} {asked[option]}: expected at least 1" for option in too_few if too_few[option])
    if given.cluster and given.jobs != 1:
        yield f"--jobs {given.jobs}: with --cluster, as many processes as the cluster has CPUs"
    if given.records and given.records.is_file():
        yield f"--records: {given.records} is a file, not a folder"


def parser() -> argparse.ArgumentParser:
    """The options of the command."""
    made = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    add, many = made.add_argument, {"nargs": "+", "action": "extend"}
    add("name", choices=NAMES)
    text = "where to write the figures (a page of the same name beside it)"
    add("--json", type=Path, help=text)
    add("--jobs", type=int, default=1, help="processes at the same time")
    add("--gate", action="store_true", help="compare with the committed baseline, write nothing")
    add("--quick", action="store_true", help="a small sample; written only with --json")
    text = "of benchmarks with sets (association, loop, scale, ...): only these; written only with --json"
    add("--sets", **many, default=[], metavar="NAME[:COUNT]", help=text)
    text = f"of {', '.join(HAVING['with'])}: modules that register others to compare; written only with --json"
    add("--with", **many, default=[], metavar="MODULE", dest="modules", help=text)
    text = "of speed and start: compare the working tree with this commit; written only with --json"
    add("--against", metavar="GIT_REF", help=text)
    text = "every N-th unit only, from the I-th; then the command without --shard gives the figures"
    add("--shard", default=str(WHOLE), metavar="I/N", help=text)
    text = f"of {', '.join(HAVING['records'])}: the drives that are replayed; missing ones are made there and stay"
    add("--records", type=Path, metavar="FOLDER", help=text)
    add("--cluster", default="", metavar="HOST:PORT", help="run the units on the Ray cluster at this address")
    add("--task", default="", help="of uncertainty: a task of active SLAM; default: ActiveHalls-v0")
    text = "of uncertainty: names, run folders or module:Class; default: nearest, gain, returning and others"
    add("--policies", **many, default=[], metavar="POLICY", help=text)
    add("--buildings", type=int, default=0, metavar="N", help="of uncertainty: at each point, 50")
    return made


def measure(name: str, module: Any, options: Options) -> Figures:
    """Content of a result file: the figures with date, machine and command; of two calibrations, the faster counts."""
    before = common.calibration_ms()
    figures = module.run(options)
    return {
        "benchmark": name,
        "date": datetime.now(UTC).date().isoformat(),
        "command": " ".join(["python -m benchmarks", *sys.argv[1:]]),
        "machine": common.machine(),
        "calibration_ms": min(before, common.calibration_ms()),
        "figures": figures,
    }


def gate(content: Figures) -> int:
    """Print what differs from the committed baseline."""
    baseline = common.RESULTS / f"{content['benchmark']}.json"
    if not baseline.is_file():
        print(f"gate failed: no baseline {baseline.name}")
        return 1
    found = common.differences(content, json.loads(baseline.read_text()))
    print("\n".join(["gate failed:", *found] if found else ["gate passed"]))
    return 1 if found else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that temporary folders are removed
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("python -m benchmarks: interrupted; the same command continues", file=sys.stderr)
        sys.exit(INTERRUPTED)
