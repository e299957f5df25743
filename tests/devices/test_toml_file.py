from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError, UsageError
from mbtool.devices.loading import TomlError, read_toml

if TYPE_CHECKING:
    from pathlib import Path

MAX_BYTES = 10


def _read(path: Path, hint: str = "write a = 1") -> dict[str, object]:
    return read_toml(path, MAX_BYTES, "list", hint)


def _told(path: Path, data: bytes, hint: str = "") -> TomlError:
    path.write_bytes(data)
    with pytest.raises(TomlError) as caught:
        _read(path, hint)
    return caught.value


def test_keys_come_in_their_order(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("b=1\na=2")
    assert list(_read(path).items()) == [("b", 1), ("a", 2)]


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1")
    assert _read(path) == {"a": 1}


@pytest.mark.parametrize(
    ("data", "place", "problem"),
    [
        (b"a=1\nb 2", "line 2, column 3", "not TOML: Expected '=' after a key"),
        (b"a=1\na=2\n", "line 2, column 4", "not TOML: Cannot overwrite a value; the key of this"),
        (b"a = \xff", "byte 4", "not UTF-8, so not TOML; save it as UTF-8"),
        (b"a = 1 # long", "size", "more than 10 bytes are no list"),
    ],
)
def test_invalid_toml_is_reported_with_file_and_line(
    tmp_path: Path, data: bytes, place: str, problem: str
) -> None:
    path = tmp_path / "a.toml"
    told = _told(path, data)
    assert told.place == place
    assert told.problem.startswith(problem)
    assert str(told) == f"{path}: {place}: {told.problem}"
    assert isinstance(told, UsageError)


def test_too_deep_nesting_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    for data in (b"a = " + b"[" * 100_000, b"a." * 20_000 + b"a = 1"):
        path.write_bytes(data)
        with pytest.raises(TomlError, match=r"a\.toml: TOML: nested too deep: "):
            read_toml(path, 1 << 20, "list")


def test_a_hint_follows_the_parsers_message(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    assert str(_told(path, b"a 1", "write a = 1")).endswith("; write a = 1")
    assert str(_told(path, b"a 1")).endswith(" around a key with spaces")


def test_a_file_of_exactly_the_maximum_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"a = 1".ljust(MAX_BYTES))
    assert _read(path) == {"a": 1}
    path.write_bytes(b"a = 1".ljust(MAX_BYTES + 1))
    with pytest.raises(TomlError, match="more than 10 bytes are no list"):
        _read(path)


def test_a_file_that_cannot_be_read_is_no_wrong_usage(tmp_path: Path) -> None:
    for path, reason in ((tmp_path, "Is a directory"), (tmp_path / "no.toml", "No such file")):
        with pytest.raises(InputError, match=f"{path}: cannot be read: {reason}"):
            _read(path)
