"""mbtool devices."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.cli import exit_codes
from mbtool.devices import builtin_profiles

if TYPE_CHECKING:
    from tests.cli.program import CommandLine


def test_lists_the_built_in_profiles(mbtool: CommandLine) -> None:
    told = mbtool("devices")
    assert (told.code, told.err) == (exit_codes.DONE, "")
    assert [line.split()[0] for line in told.lines] == ["name", *builtin_profiles()]
    assert max(map(len, told.lines)) <= 100


def test_shows_one_in_full(mbtool: CommandLine) -> None:
    told = mbtool("devices", "idec-ft1a-touch")
    assert told.lines[0] == "FT1A Touch operator interface, Modbus RTU slave"
    assert "holding register  HR400001..404096  0000..0FFF  holding registers  read, write" in (
        told.out
    )
