"""What `mbtool test` says before, between and after its cases."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.core import Endpoint, TcpLink
from mbtool.devices import load_profile
from mbtool.workflows.slave import device_slave
from tests.cli.program import CommandLine, Program

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PROFILE = "fa3-at1m8x"


@pytest.fixture
def link() -> Iterator[str]:
    with device_slave(load_profile(PROFILE), TcpLink(Endpoint("127.0.0.1", 0)), 1) as slave:
        yield slave.place


def test_a_report_that_cannot_be_written_is_told_before_the_run(
    mbtool: CommandLine, link: str, tmp_path: Path
) -> None:
    old = tmp_path / "old.xml"
    old.write_text("kept")
    for file, told in (
        (tmp_path / "absent" / "result.xml", f"there is no folder {tmp_path / 'absent'}"),
        (old, "the file exists; name another, remove it, or replace it with --overwrite"),
    ):
        said = mbtool("test", PROFILE, link, "--report", file)
        assert said.code == 2
        assert told in said.err
        assert "testing" not in said.err
    assert old.read_text() == "kept"
    assert mbtool("test", PROFILE, link, "--report", old, "--overwrite").code == 0
    assert "<testsuite" in old.read_text()


def test_an_interruption_says_in_which_run_it_came(link: str) -> None:
    with Program("test", PROFILE, link, "--repeat", "1000") as program:
        program.await_said("testing unit 1")
        said = program.end(signal.SIGINT)
    assert said.code == 130
    assert "interrupted in run " in said.err
    assert said.err.endswith(" of 1000; the cases after that were not run\n")
