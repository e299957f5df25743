"""Power cuts, a few of each program; python -m tests.power_cuts tries many."""

from __future__ import annotations

import random
from typing import TYPE_CHECKING

import pytest

from tests.power_cuts.__main__ import compiled, cut_often
from tests.power_cuts.disk import Disk, Record
from tests.power_cuts.programs import Program, Repeated, all_programs

if TYPE_CHECKING:
    from pathlib import Path

CUTS = 12
_PROGRAMS = all_programs()


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = compiled(tmp_path_factory.mktemp("journal"))
    if found is None:
        pytest.skip("there is no C compiler, or this is not Linux")
    return found


@pytest.mark.parametrize("program", _PROGRAMS, ids=[one.name for one in _PROGRAMS])
def test_nothing_that_was_promised_is_missing_after_a_power_cut(
    program: Program, library: Path
) -> None:
    assert cut_often(program, library, CUTS, seed=1) == []


@pytest.mark.parametrize(
    "code",
    [
        "new = folder / 'new'; new.write_text(number); new.replace(folder / 'file')",
        "import os; new = (folder / 'new').open('w'); new.write(number); new.flush(); "
        "os.fsync(new.fileno()); new.close(); os.replace(folder / 'new', folder / 'file')",
        "(folder / 'file').write_text(number)",
    ],
    ids=["no sync", "no sync of the folder", "no replacing"],
)
def test_a_file_that_is_replaced_with_fewer_syncs_is_found_wrong(code: str, library: Path) -> None:
    assert cut_often(Repeated("without a sync", "file", code), library, 40, seed=1)


def test_of_what_was_not_synced_any_pieces_may_be_left(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    disk = Disk(root)
    name = str(root / "a")
    for record in (
        Record("O", 0, 7, 0, name, "", b""),
        Record("W", 0, 7, 0, name, "", b"a" * 1024),
        Record("B", 0, 7, 1, name, "", b""),
        Record("W", 0, 7, 512, name, "", b"b" * 1024),
        Record("E", 0, 7, 1, name, "", b""),
        Record("B", 0, 1, 2, str(root), "", b""),
        Record("E", 0, 1, 2, str(root), "", b""),
    ):
        disk.note(record)
    assert disk.files[0].promised == b"a" * 1024
    chance = random.Random(1)
    left = set()
    for number in range(400):
        disk.cut(chance, tmp_path / str(number))
        left.add((tmp_path / str(number) / "a").read_bytes())
    whole = b"a" * 512 + b"b" * 1024
    torn = b"a" * 1024 + b"b" * 512
    assert {b"a" * 1024, whole, torn} <= left
    assert all(one.startswith(b"a" * 512) for one in left)


def test_a_name_that_was_not_synced_may_be_lost(tmp_path: Path) -> None:
    root = tmp_path / "root"
    root.mkdir()
    disk = Disk(root)
    disk.note(Record("O", 0, 7, 0, str(root / "a"), "", b""))
    disk.note(Record("R", 0, 0, 0, str(root / "a"), str(root / "b"), b""))
    chance = random.Random(1)
    found = set()
    for number in range(40):
        disk.cut(chance, tmp_path / str(number))
        found.add(tuple(sorted(path.name for path in (tmp_path / str(number)).iterdir())))
    assert found == {(), ("a",), ("b",)}
