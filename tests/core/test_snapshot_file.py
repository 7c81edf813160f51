"""Snapshots in files: every value to the last bit, one error for whatever is wrong."""

import io
import json
import os
import tracemalloc
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mecp_env.core.snapshot import StateError, decode, encode
from mecp_env.core.snapshot_file import FileKind, load_snapshot, save_snapshot
from mecp_env.episode.observations import TravelledPath
from mecp_env.slam.messages import FEATURE, Cell, CornerKind, FeatureTable
from mecp_env.world.config import LaserConfig
from tests.env.helpers import same

KIND = FileKind("mecp_env test", 3, "0.1.0")
VALUES = [None, True, 1, 1.0, -0.0, float("nan"), float("inf"), 2**70, "\u00e4\U0001f600\x00", [], (), {"@list": 1}]
VALUES += [(1, (2.0, "x")), {1: "a", (2, 3): [np.int64(2**62)]}, {3, 1, 2}, frozenset({2}), np.random.default_rng(3)]
VALUES += [np.float64(0.1), np.bool_(True), np.array(3.5), np.array([True, False]), np.array(["a", "bc"])]
VALUES += [np.arange(6.0).reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.empty((0, 2))]
VALUES += [np.zeros((7, 0, 0), np.int16), np.zeros(3, FEATURE), FeatureTable(), TravelledPath()]
VALUES += [Cell.DOOR, CornerKind.JAMB, LaserConfig(preset="ideal")]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "kept.zip"


def test_values_come_back_to_the_last_bit(path: Path) -> None:
    save_snapshot(path, KIND, encode(VALUES))
    again = decode(load_snapshot(path, KIND))
    for read, value in zip(again, VALUES, strict=True):
        assert same(encode(read), encode(value))
        assert type(read) is type(value)
    save_snapshot(path, KIND, encode(np.array([1.5, -2.0], ">f8")))
    assert same(decode(load_snapshot(path, KIND)), np.array([1.5, -2.0]))
    with pytest.raises(StateError, match=r"gone\.zip: no such file"):
        load_snapshot(path.with_stem("gone"), KIND)


def test_equal_states_give_equal_files_and_a_failed_save_leaves_the_old_one(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_snapshot(path, KIND, encode([1.0]))
    before = path.read_bytes()
    save_snapshot(path, KIND, encode([1.0]))
    assert path.read_bytes() == before

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device.*kept\.zip"):
        save_snapshot(path, KIND, encode([2.0]))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def packed(members: dict[str, bytes]) -> bytes:
    """A zip with these members."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in members.items():
            archive.writestr(name, part)
    return buffer.getvalue()


def with_state(text: str, arrays: bytes = b"12345678", **header: Any) -> bytes:
    """A file with this state as JSON, and other fields of the header."""
    content = json.dumps(KIND._asdict() | header)[:-1] + f', "state": {text}}}'
    return packed({"state.json": content.encode(), "arrays.bin": arrays})


LARGE = '{"@array": [{"@bytes": ["<f8", [1000000], 0]}, true]}'
ZEROS = with_state("{}", bytes(100_000_000))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "no mecp_env test, or cut short"),
        (packed({}), r"no mecp_env test: it holds \[\]"),
        (packed({"state.json": b"{"}), "damaged .JSONDecodeError"),
        (with_state("null", format="mecp_env map"), "format: 'mecp_env map', expected 'mecp_env test'"),
        (with_state("null", version=4, package="9.0"), r"version: 4 \(of mecp_env 9\.0\), this .* reads .* 3"),
        (with_state('{"@bytes": ["<f8", [2], 0]}'), "arrays.bin: arrays of more bytes"),
        (with_state('{"@bytes": ["|O", [1], 0]}'), r"array: '\|O' \[1\] from 0 on"),
        (with_state('{"@list": [' + "[]," * 1_000_000 + "[]]}"), "state.json: .* parts, at most"),
        (with_state(f'{{"@list": [{LARGE}, {LARGE}]}}', bytes(8_000_000)), ".* more bytes than there are"),
        (with_state("[" * 100_000 + "]" * 100_000), "damaged .RecursionError"),
        (ZEROS, "arrays.bin: it has"),
        (ZEROS.replace((100_000_000).to_bytes(4, "little"), (1000).to_bytes(4, "little")), ""),  # it hides its size
    ],
    ids=range(12),
)
def test_whatever_is_wrong_gives_one_error_that_names_the_file(data: bytes, message: str, path: Path) -> None:
    path.write_bytes(data)
    tracemalloc.start()
    with pytest.raises(StateError, match=rf"kept\.zip: {message}"):
        load_snapshot(path, KIND)
    assert tracemalloc.get_traced_memory()[1] < 60e6
    tracemalloc.stop()
    assert path.read_bytes() == data


def test_what_is_shared_or_read_only_stays_so_cycles_hold_and_a_generator_continues():
    array, rng = np.zeros(3), np.random.default_rng(5)
    array.setflags(write=False)
    rng.normal(size=3)
    pair = [array, array, (array,), rng]
    pair.append(pair)
    again = decode(encode(pair))
    assert again[0] is again[1] is again[2][0]
    assert not again[0].flags.writeable
    assert again[3].normal() == rng.normal()
    assert again[4] is again


@dataclass
class Foreign:
    x: int = 1


@pytest.mark.parametrize("value", [print, Foreign(), np.array([None])], ids=lambda value: type(value).__name__)
def test_what_no_state_may_hold_is_refused(value):
    with pytest.raises(TypeError):
        encode(value)
    with pytest.raises(StateError, match=r"TravelledPath\.points: a state holds no "):
        encode(TravelledPath(points=value))


NOT_HELD = ["os:system", "mecp_env.nowhere:X", "mecp_env.cli.main:Command", "mecp_env.core.snapshot:encode"]
DAMAGED = [{"@object": [name, {}]} for name in NOT_HELD]
DAMAGED += [{"@object": ["mecp_env.core.processes:Connection", {"_handle": 1, "_readable": True, "_writable": True}]}]
DAMAGED += [{"@enum": ["mecp_env.slam.messages:FeatureTable", 1]}, {"@nothing": 1}, {"@same": 3}]
DAMAGED += [{"@settings": ["mecp_env.world.config:LaserConfig", {"preset": "best"}]}]


@pytest.mark.parametrize("data", DAMAGED, ids=str)
def test_damaged_data_is_refused(data):
    with pytest.raises(StateError):
        decode(data)
