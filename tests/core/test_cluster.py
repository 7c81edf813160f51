"""Units on a Ray cluster: the results of processes here, to the bit; every fault in one line."""

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from mecp_env.cli import main as cli
from mecp_env.core.errors import ConfigError
from mecp_env.core.work_units import FailedUnit, attempt, code_of, connected, run_on_cluster, run_units

ROOT = Path(__file__).parents[2]
HEAD, OTHER = "127.0.0.2", "127.0.0.3"  # loopback; Ray takes 127.0.0.1 for the outer address


@pytest.fixture(scope="module")
def two_nodes() -> Iterator[str]:
    """The address of a cluster of two nodes with one CPU each, on the loopback interface of this machine."""
    pytest.importorskip("ray", reason="the extra `cluster` is not installed")
    from ray.cluster_utils import Cluster

    patch = pytest.MonkeyPatch()
    patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    patch.setenv("PYTHONPATH", str(ROOT))  # as with `python -m benchmarks` in a shared folder
    node = {"num_cpus": 1, "object_store_memory": 80 * 2**20}
    nodes = Cluster(initialize_head=True, head_node_args=node | {"node_ip_address": HEAD, "include_dashboard": False})
    nodes.add_node(**node, node_ip_address=OTHER)
    try:
        yield nodes.address
    finally:
        nodes.shutdown()
        patch.undo()


def root(number: int) -> dict[str, Any]:
    """A square root with the process that found it; negative numbers fail, and 13 ends its process."""
    if number == 13:
        os._exit(1)
    if number < 0:
        raise ValueError(f"no root of {number}")
    return {"root": number**0.5, "process": os.getpid()}


@pytest.mark.slow
def test_a_failed_unit_does_not_end_the_others(two_nodes: str) -> None:
    results = dict(run_on_cluster(root, [4, -1, 13, 9, 16, 25, 36], two_nodes))
    failed = {number: result for number, result in results.items() if isinstance(result, FailedUnit)}
    assert set(results) == set(range(7))
    assert {number: failure.unit for number, failure in failed.items()} == {1: -1, 2: 13}
    assert failed[1].reason.startswith("ValueError: no root of -1 (root, line ")
    assert isinstance(failed[1].error, ValueError)
    assert "\n" not in failed[2].reason
    rest = [results[number] for number in (0, 3, 4, 5, 6)]
    assert [one["root"] for one in rest] == [2.0, 3.0, 4.0, 5.0, 6.0]
    assert os.getpid() not in {one["process"] for one in rest}
    assert not sys.modules["ray"].is_initialized()


@pytest.mark.slow
def test_an_evaluation_on_the_cluster_is_that_of_this_machine(two_nodes: str, tmp_path: Path) -> None:
    line = ["evaluate", "nearest", "--episodes", "2", "--max-steps", "20", "--no-truth", "--difficulty", "easy"]
    for name, where in (("cluster", ["--cluster", two_nodes]), ("here", [])):
        assert cli.main([*line, *where, "--out", str(tmp_path / name)]) == 0
    csv = [(tmp_path / name / "episodes.csv").read_bytes() for name in ("cluster", "here")]
    assert csv[0] == csv[1]
    rows = [json.loads((tmp_path / name / "results.json").read_text())["rows"] for name in ("cluster", "here")]
    assert json.dumps(rows[0]) == json.dumps(rows[1])


@pytest.mark.parametrize("address", ["auto", "ray://127.0.0.1:10001", "127.0.0.1:0"])
def test_only_the_address_of_a_running_cluster_is_taken(address: str) -> None:
    with pytest.raises(ConfigError, match=r"cluster: .*, expected HOST:PORT"), connected(address):
        pass


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match="Ray is not installed; the extra `cluster` has it"), connected("127.0.0.1:1"):
        pass


def test_a_node_says_in_one_line_what_failed_and_refuses_the_work_with_other_code() -> None:
    failed = attempt(root, -4, code_of(root))
    assert failed.reason == next(iter(dict(run_units(root, [-4], 1)).values())).reason
    failed = attempt(root, 4, code_of(root) | {"numpy": "0.1"})
    assert failed.reason.startswith("ConfigError: cluster: a node has numpy ")
    assert ", not 0.1 (attempt, line" in failed.reason
