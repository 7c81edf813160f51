"""The command of the benchmarks: run one, write or compare its figures; the same command continues after a kill."""

from __future__ import annotations

import argparse
import importlib
import json
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.common import (
    RECORDS,
    RESULTS,
    UNITS,
    Figures,
    OptionError,
    Options,
    ShardDone,
    calibration_ms,
    failures,
    markdown,
    result,
    save,
)
from benchmarks.trees import TreeError
from mecp_env.core.errors import ConfigError, MecpError
from mecp_env.core.interrupts import INTERRUPTED
from mecp_env.core.work_units import WHOLE, Shard
from mecp_env.render.figures import save as save_figure

RECORD = "record"  # makes what others replay, and has no figures
KINDS = {  # of each benchmark, what it has beside its figures
    "ablation": "units records",
    "association": "units open records",
    "association_time": "units here records",
    "claims": "units records",
    "clutter": "units open records",
    "consistency": "units open records",
    "explorers": "units",
    "features": "units",
    "figures": "records",
    "filters": "units open",
    "formats": "",
    "kidnap": "units records",
    "learning": "",
    "loop": "units records",
    "map_size": "units here open records",
    "mutated": "units",
    "noise": "units records",
    "paper_mode": "units records",
    "real": "units here records",
    "replay": "",
    "restore": "units",
    "returns": "units policies",
    "scale": "units here",
    "sensors": "units records",
    "soak": "units here",
    "speed": "compared",
    "start": "compared",
    "stock_ppo": "",
    "structures": "units open records",
    "uncertainty": "units policies",
    "vector": "",
    "vector_step": "",
    "victoria_park": "open",
    "worlds": "units",
}


def those(kind: str) -> tuple[str, ...]:
    """The benchmarks of a kind."""
    return tuple(name for name, kinds in KINDS.items() if kind in kinds.split())


NAMES = tuple(KINDS)
OPEN = those("open")  # compare registered parts too
COMPARED = those("compared")  # comparable with another commit
IN_UNITS = those("units")  # of work, kept and divided
HERE_ONLY = those("here")  # times and memory of this machine; maps beside results
OVER_POLICIES = those("policies")  # --task, --policies, --buildings
WITH_RECORDS = (*those("records"), RECORD)  # --records
COLOURS = 128  # of a committed picture: lines and areas need no more


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0, or 1 where a gate or a bound failed, or 2 for a wrong command line."""
    given = parser().parse_args(arguments)
    module = importlib.import_module(f"benchmarks.{given.name}")
    options = options_of(given, module)
    if given.name == "speed" and given.against:
        module = importlib.import_module("benchmarks.against")
    try:
        content = measure(given.name, module, options)
    except OptionError as error:
        parser().error(str(error))
    except (TreeError, MecpError) as error:
        print(f"python -m benchmarks: {error}", file=sys.stderr)
        return 1
    except ShardDone as done:
        print(f"{done}; after all shards, the same command without --shard gives the figures")
        return 0
    shutil.rmtree(options.folder, ignore_errors=True)  # another run measures again
    report = getattr(module, "report", None)
    page = markdown(content, report(content["figures"]) if report else None)
    print(page)
    if given.name == RECORD:
        return 0  # the records are the result
    if given.gate:
        return gate(module, content, RESULTS / f"{given.name}.json")
    if given.json or not (given.quick or given.sets or given.modules or given.against):
        path = given.json or RESULTS / f"{given.name}.json"
        save(content, page + (f"\n![{given.name}]({path.stem}.png)\n" if hasattr(module, "figure") else ""), path)
        if hasattr(module, "figure"):
            save_figure(module.figure(content["figures"]), path.with_suffix(".png"))
        if hasattr(module, "pictures"):
            save_pictures(module.pictures(options), path.with_suffix(""))
    faults = module.faults(content["figures"]) if hasattr(module, "faults") else []
    print(*(f"failed: {fault}" for fault in faults), sep="\n", end="\n" * bool(faults), file=sys.stderr)
    return 1 if faults else 0


def save_pictures(pictures: dict[str, Figure], folder: Path) -> None:
    """Write each picture into the folder as PNG and SVG, without date and random ids."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        save_figure(picture, folder / f"{name}.png", dpi=200)
        with Image.open(folder / f"{name}.png") as drawn:
            few = drawn.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(folder / f"{name}.png", optimize=True)
        with rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
            picture.savefig(folder / f"{name}.svg", dpi=200, metadata={"Date": None, "Creator": None})


def options_of(given: argparse.Namespace, module: Any) -> Options:
    """The options of a benchmark; ends the process with 2 for one that it does not have."""
    faults = (text for text, is_wrong in (*wrong_options(given, module), *wrong_places(given)) if is_wrong)
    for text in faults:
        parser().error(text)
    return Options(
        given.jobs,
        given.quick,
        tuple(given.sets),
        tuple(given.modules),
        given.against,
        given.sweeps or (1, 4),
        given.shard,
        (UNITS / given.name).absolute(),
        (given.records or (RECORDS if given.name == RECORD else UNITS / given.name / "records")).absolute(),
        given.cluster,
        given.task,
        tuple(given.policies),
        given.buildings,
    )


def wrong_options(given: argparse.Namespace, module: Any) -> Iterator[tuple[str, object]]:
    """What is said of each option that only some benchmarks have, and whether this one lacks it."""
    name = given.name
    yield f"--sets: {name} is measured whole", given.sets and not hasattr(module, "SETS")
    compare = f"--with: {name} compares no associators and no filters; {' and '.join(OPEN)} do"
    yield compare, given.modules and name not in OPEN
    only = f"--against: only for {' and '.join(COMPARED)}, and not with --gate"
    yield only, given.against and (name not in COMPARED or given.gate)
    yield "--sweeps: only for speed --against", given.sweeps and not (given.against and name == "speed")
    whole = f"--shard: {name} is measured whole; {', '.join(IN_UNITS)} have units"
    yield whole, given.shard != WHOLE and name not in (*IN_UNITS, RECORD)
    policies = f"--task, --policies, --buildings: only for {' and '.join(OVER_POLICIES)}"
    yield policies, (given.task or given.policies or given.buildings) and name not in OVER_POLICIES


def wrong_places(given: argparse.Namespace) -> Iterator[tuple[str, object]]:
    """The same of the places of units and of drives."""
    name, able = given.name, [name for name in (*IN_UNITS, RECORD) if name not in HERE_ONLY]
    here = f"--cluster: {name} runs here; {', '.join(able)} run on a cluster, too"
    yield here, given.cluster and name not in able
    jobs = f"--jobs {given.jobs}: with --cluster, as many processes as the cluster has CPUs"
    yield jobs, given.cluster and given.jobs != 1
    replays = f"--records: {name} replays no drives; {', '.join(WITH_RECORDS)} do"
    yield replays, given.records and name not in WITH_RECORDS
    is_file = given.records and given.records.exists() and not given.records.is_dir()
    yield f"--records: {given.records} is a file, not a folder", is_file


def parser() -> argparse.ArgumentParser:
    """The options of the command."""
    made = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    add, many = made.add_argument, {"nargs": "+", "action": "extend"}
    add("name", choices=(*NAMES, RECORD))
    add("--json", type=Path, help="where to write the figures (a page of the same name beside it)")
    add("--jobs", type=positive, default=1, help="processes at the same time")
    add("--gate", action="store_true", help="compare with the committed baseline, write nothing")
    add("--quick", action="store_true", help="a small sample; written only with --json")
    text = "of benchmarks with sets (association, loop, scale, ...): only these; written only with --json"
    add("--sets", **many, default=[], metavar="NAME[:COUNT]", help=text)
    text = "of association and filters: modules that register others to compare; written only with --json"
    add("--with", **many, default=[], metavar="MODULE", dest="modules", help=text)
    text = "of speed and start: compare the working tree with this commit; written only with --json"
    add("--against", metavar="GIT_REF", help=text)
    add("--sweeps", type=positive, **many, metavar="K", help="of speed --against: sweeps per scan, default 1 and 4")
    text = "every N-th unit only, from the I-th; then the command without --shard gives the figures"
    add("--shard", type=shard, default=WHOLE, metavar="I/N", help=text)
    text = f"of {', '.join(WITH_RECORDS)}: the drives that are replayed; missing ones are made there and stay"
    add("--records", type=Path, metavar="FOLDER", help=text)
    add("--cluster", default="", metavar="HOST:PORT", help="run the units on the Ray cluster at this address")
    add("--task", default="", help="of uncertainty: a task of active SLAM; default: ActiveHalls-v0")
    text = "of uncertainty: names, run folders or module:Class; default: nearest, gain, returning and others"
    add("--policies", **many, default=[], metavar="POLICY", help=text)
    add("--buildings", type=positive, default=0, metavar="N", help="of uncertainty: at each point, 50")
    return made


def shard(text: str) -> Shard:
    """`text` as a part of the work."""
    try:
        return Shard.parse(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def positive(text: str) -> int:
    """`text` as a number, at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, given {number}")
    return number


def measure(name: str, module: Any, options: Options) -> Figures:
    """Run a benchmark between two calibrations; the faster one counts."""
    before = calibration_ms()
    figures = module.run(options)
    return result(name, figures, min(before, calibration_ms()))


def gate(module: Any, content: Figures, baseline: Path) -> int:
    """Print what is worse than the committed baseline."""
    gates = getattr(module, "GATES", ())
    if not gates or not baseline.is_file():
        print(f"gate failed: {'no gates defined' if not gates else f'no baseline {baseline.name}'}")
        return 1
    worse = failures(gates, content, json.loads(baseline.read_text()))
    print("\n".join(["gate failed:", *worse]) if worse else f"gate passed: {len(gates)} figures")
    return 1 if worse else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that temporary folders are removed
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        print("python -m benchmarks: interrupted; the same command continues", file=sys.stderr)
        sys.exit(INTERRUPTED)
