"""mbtool line, until it is ended."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

from mbtool.cli import exit_codes
from mbtool.core import SerialLink
from mbtool.master.links import open_master
from tests.cli.program import Program
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import FAST
from tests.workflows.evidence import READ

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine


def test_a_line_is_there_until_it_is_ended(tmp_path: Path) -> None:
    ends = [tmp_path / "slave", tmp_path / "master"]
    with Program("line", *ends, "--settings", str(FAST)) as program:
        assert program.process.stdout is not None
        assert [program.process.stdout.readline() for _ in ends] == [f"{end}\n" for end in ends]
        program.await_said("2 ends of one line at 115200-8N1; Ctrl-C takes it down")
        with Program("slave", "idec-ft1a-touch", "--on", f"rtu:{ends[0]}@{FAST}") as slave:
            slave.await_said("Ctrl-C ends")
            with open_master(SerialLink(str(ends[1]), FAST), MASTER_TIMEOUT_NS) as master:
                assert master.ask(1, READ) == bytes.fromhex("03 04 0000 0000")
            assert slave.end(signal.SIGINT).code == exit_codes.INTERRUPTED
        assert program.end(signal.SIGTERM).code == exit_codes.INTERRUPTED
    assert list(tmp_path.iterdir()) == []


def test_an_end_that_could_not_be_reached_is_a_wrong_use(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    told = mbtool("line", tmp_path / "q1", f"{tmp_path}/./q1")
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err.endswith("q1: named twice; each end of a line has a name of its own\n")
    assert list(tmp_path.iterdir()) == []
