"""Folders and patterns of capture files."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from mbtool.core import InputError
from mbtool.workflows.shared.named_files import named_files

if TYPE_CHECKING:
    from pathlib import Path

NAMES = (
    "b/site-10.pcap", "b/site-2.pcap.gz", "b/notes.txt", "a.mcap", "b/c/x.pcapng", "b/y.PCAP3",
    "b/report.html", "b/z.cap.zst", "b/.lock",
)  # fmt: skip


@pytest.fixture(autouse=True)
def _captures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")


@pytest.mark.parametrize(
    ("named", "found"),
    [
        ("a.mcap", ["a.mcap"]),
        ("-", ["-"]),
        ("none.pcap", ["none.pcap"]),
        ("b", ["b/c/x.pcapng", "b/site-2.pcap.gz", "b/site-10.pcap", "b/y.PCAP3", "b/z.cap.zst"]),
        ("b/site-*", ["b/site-2.pcap.gz", "b/site-10.pcap"]),
        ("b/?ote*", ["b/notes.txt"]),
        ("**/*.pcapng", ["b/c/x.pcapng"]),
    ],
)
def test_a_name_stands_for_its_files_in_the_order_of_their_names(
    named: str, found: list[str]
) -> None:
    assert named_files([named]) == [one.replace("/", os.sep) for one in found]


def test_a_file_whose_name_looks_like_a_pattern_is_that_file(tmp_path: Path) -> None:
    (tmp_path / "x[1].pcap").write_bytes(b"")
    (tmp_path / "x1.pcap").write_bytes(b"")
    assert named_files(["x[1].pcap"]) == ["x[1].pcap"]


def test_a_file_with_several_names_is_taken_once_and_not_by_that_of_a_link(tmp_path: Path) -> None:
    try:
        (tmp_path / "d").mkdir()
        (tmp_path / "d" / "1.mcap").symlink_to(tmp_path / "d" / "2.mcap")
        (tmp_path / "d" / "3.mcap").symlink_to(tmp_path / "a.mcap")
        (tmp_path / "d" / "4.mcap").symlink_to(tmp_path / "a.mcap")
    except OSError:
        pytest.skip("links need a right here")
    (tmp_path / "d" / "2.mcap").write_bytes(b"")
    second, third = os.path.join("d", "2.mcap"), os.path.join("d", "3.mcap")
    assert named_files(["d"]) == [second, third]
    assert named_files(["d/*.mcap", "d"]) == [second, third]
    assert named_files(["d", "a.mcap"]) == [second, "a.mcap"]
    assert named_files(["a.mcap", "a.mcap"]) == ["a.mcap", "a.mcap"]  # The reader refuses this.


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFO here")
def test_a_fifo_in_a_folder_is_no_capture(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "1.mcap").write_bytes(b"")
    os.mkfifo(tmp_path / "d" / "2.mcap")
    first = os.path.join("d", "1.mcap")
    assert named_files(["d"]) == named_files(["d/*.mcap"]) == [first]


def test_several_names_are_taken_in_their_order() -> None:
    assert named_files(["b/c", "a.mcap"]) == [os.path.join("b/c", "x.pcapng"), "a.mcap"]


@pytest.mark.parametrize(
    ("named", "said"),
    [("*.pcap", r"\*\.pcap: no file fits this pattern"), ("empty", "empty: no capture in this")],
)
def test_a_name_that_stands_for_no_file_is_one_clear_line(
    named: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=said):
        named_files([named])
