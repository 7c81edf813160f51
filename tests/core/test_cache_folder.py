"""Compiled functions are kept only where no other user can place a file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from mecp_env.core.jit_cache import is_private, own_bytes, usable

pytestmark = pytest.mark.skipif(os.name != "posix", reason="rights of POSIX")


def test_a_folder_of_this_user_is_private(tmp_path: Path) -> None:
    assert is_private(tmp_path)
    assert usable(tmp_path / "new" / "leaf")


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o757])
def test_a_leaf_that_others_write_to_is_not(mode: int, tmp_path: Path) -> None:
    leaf = tmp_path / "leaf"
    leaf.mkdir()
    leaf.chmod(mode)
    assert not is_private(leaf)


def test_a_folder_above_may_be_shared_where_only_the_owner_removes(tmp_path: Path) -> None:
    leaf = tmp_path / "above" / "leaf"
    leaf.mkdir(parents=True)
    leaf.parent.chmod(0o1777)
    assert is_private(leaf)
    leaf.parent.chmod(0o777)
    assert not is_private(leaf)


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="gives files to another user")
def test_what_belongs_to_another_user_is_not_read(tmp_path: Path) -> None:
    leaf = tmp_path / "above" / "leaf"
    leaf.mkdir(parents=True)
    entry = leaf / "entry.nbc"
    entry.write_bytes(b"x")
    assert own_bytes(entry) == b"x"
    os.chown(entry, 65534, 65534)
    with pytest.raises(PermissionError):
        own_bytes(entry)
    os.chown(leaf.parent, 65534, 65534)
    assert not is_private(leaf)
