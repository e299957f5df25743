from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError
from mbtool.slave.toml_file import read_toml

if TYPE_CHECKING:
    from pathlib import Path


def _read(path: Path) -> dict[str, object]:
    return read_toml(path, 10, "list", "write a = 1")


def test_keys_come_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("b=1\na=2")
    assert list(_read(path).items()) == [("b", 1), ("a", 2)]


def test_a_mark_that_editors_set_at_the_beginning_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1")
    assert _read(path) == {"a": 1}


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"a = 1 # long", "more than 10 bytes are no list"),
        (b"a = ", r"not TOML: .*; write a = 1"),
        (b"\xff", r"not TOML: .*; write a = 1"),
    ],
)
def test_what_cannot_be_read_is_told(tmp_path: Path, data: bytes, problem: str) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(data)
    with pytest.raises(InputError, match=problem):
        _read(path)
    with pytest.raises(InputError, match="cannot be read"):
        _read(tmp_path)
