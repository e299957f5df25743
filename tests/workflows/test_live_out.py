"""What a recording tells brokers and commands."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import pytest

from mbtool.core import UsageError
from mbtool.troubles.trouble import Trouble
from mbtool.workflows.live_out import KeptFiles, TroubleCommands, _id

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.logs.rotation import RotatingLog


@pytest.mark.parametrize(("one", "other"), [("Größe", "Grüße"), ("a b", "a_b"), ("温度", "压力")])
def test_different_names_have_different_ids(one: str, other: str) -> None:
    assert _id(one) != _id(other)
    assert _id(one) == _id(one)
    assert all(each.isascii() and " " not in each for each in (_id(one), _id(other)))


def test_a_name_of_plain_characters_is_its_id() -> None:
    assert _id("unit_4-flow") == "unit_4-flow"


def test_a_command_runs_for_each_trouble_of_a_group(tmp_path: Path) -> None:
    def trouble(unit: int, *others: Trouble) -> Trouble:
        return Trouble(code="LINE-REPEATED", link="/dev/a", unit=unit, others=others)

    commands = TroubleCommands([("LINE-REPEATED", f'touch "{tmp_path}/$MBTOOL_UNIT"')], pytest.fail)
    for group in (trouble(1, trouble(2)), trouble(2, trouble(1), trouble(3))):
        commands.take([group])
        for process in commands._running:
            process.wait()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["1", "2", "3"]


def test_files_are_kept_for_each_new_case_of_a_trouble() -> None:
    def missing(count: int) -> Trouble:
        return Trouble(code="UNIT-MISSING", link="/dev/a", unit=1, count=count)

    late = Trouble(code="LINE-LATE", link="/dev/a")
    kept: list[int] = []
    files = KeptFiles(["UNIT-"])
    looks = ([late], [missing(1)], [missing(2)], [missing(3), late], [missing(3)], [missing(4)])
    for number, troubles in enumerate(looks, 1):  # A file a look.
        keep = partial(kept.append, number)
        files.log = cast("RotatingLog", SimpleNamespace(number=number, keep_around=keep))
        files.take(troubles)
    assert kept == [2, 6]
    with pytest.raises(UsageError, match="--keep-around NOSUCH"):
        KeptFiles(["NOSUCH"])
