"""mbtool sniff in a process of its own, ended in every way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.core import TcpLink
from mbtool.devices import NamedTransaction
from mbtool.logs import LogReader, follow
from mbtool.master.links import open_master
from mbtool.modbus import ascii_adu
from mbtool.sources.virtual_line import VirtualLine
from tests.cli.program import (
    PATIENCE_S,
    CommandLine,
    Program,
    endpoint_in,
    full_pipe,
    full_terminal,
    patient,
)
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.bench import FAST, Bench, be_turned_away, speak
from tests.workflows.evidence import WRITE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mbtool.core import Endpoint


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as one:
        yield one


def _tap_of(program: Program) -> Endpoint:
    """Where a sniffer says that its tap listens."""
    return endpoint_in(program.await_said("listening on"))


def _ask(tap: Endpoint, count: int) -> None:
    with open_master(TcpLink(tap), MASTER_TIMEOUT_NS) as master:
        for _ in range(count):
            assert master.ask(1, WRITE) == WRITE


def _logged(path: Path) -> list[NamedTransaction]:
    with LogReader.open(path) as log:
        found = [item for item in log.items() if isinstance(item, NamedTransaction)]
        assert log.closed
        return found


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_a_complete_log(bench: Bench, tmp_path: Path, number: int) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path) as program:
        _ask(_tap_of(program), 5)
        told = program.end(number)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == f"5 transactions: 5 ok\nlog: {path}\n"
    assert told.out.count("06 write") == 5
    assert len(_logged(path)) == 5


@pytest.mark.parametrize("format_", ["table", "jsonl"])
def test_a_slave_that_cannot_be_reached_is_said_once_and_shown_again_from_the_log(
    bench: Bench, tmp_path: Path, mbtool: CommandLine, format_: str
) -> None:
    path = tmp_path / "a.mcap"
    tap = bench.refusing_tap()
    with Program("sniff", tap, "-w", path, "--format", format_) as program:
        endpoint = _tap_of(program)
        be_turned_away(endpoint)
        said = program.await_said("turned away")
        be_turned_away(endpoint)
        told = program.end(signal.SIGINT)
    why = f"{tap.target} cannot be reached: Connection refused"
    assert said == f"mbtool: a master was turned away: {why}\n"
    assert "turned away" not in told.err
    assert told.out.count(why) == (2 if format_ == "table" else 0)
    again = mbtool("decode", path)
    assert again.out.count(why) == 2
    assert again.err == "0 transactions; 2 events: 2 refused\n"


def test_a_slave_that_says_its_model_is_told_once_as_it_is_heard(bench: Bench) -> None:
    with Program("sniff", bench.tap()) as program:
        tap = _tap_of(program)
        with open_master(TcpLink(tap), MASTER_TIMEOUT_NS) as master:
            for _ in range(2):
                assert master.ask(0, b"\x42\x00\x16") == b"\x42\x00\x16"
        said = program.await_said("42H")
        told = program.end(signal.SIGINT)
    assert said.startswith("mbtool: unit 0 at 127.0.0.1:")
    assert said.endswith("name it with --device 127.0.0.1/0=fa3-at1m8x\n")
    assert told.err == "2 transactions: 2 ok\n"


def test_a_log_of_evidence_only_is_decoded_when_it_is_read(
    bench: Bench, tmp_path: Path, mbtool: CommandLine
) -> None:
    path, whole = tmp_path / "a.mcap", tmp_path / "whole.mcap"
    with Program("sniff", bench.tap(), "-w", path, "--evidence-only") as program:
        _ask(_tap_of(program), 3)
        live = program.end(signal.SIGINT)
    assert live.out.count("06 write") == 3
    with LogReader.open(path) as log:
        found = [getattr(item, "kind", "bytes") for item in log.items()]
    assert sorted(found) == ["bytes"] * 6 + ["closed", "opened"]
    again = mbtool("decode", path)
    assert again.out == live.out
    assert again.err == "3 transactions: 3 ok\n"
    assert mbtool("convert", path, whole).err == f"6 reads, 3 transactions -> {whole}\n"
    assert len(_logged(whole)) == 3
    refused = mbtool("decode", path, "--follow")
    assert (refused.code, len(refused.err.splitlines())) == (exit_codes.USAGE, 1)
    assert "decode it without --follow" in refused.err


def test_stops_after_so_many_and_logs_what_it_heard(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path, "--count", 2, "--format", "jsonl") as program:
        _ask(_tap_of(program), 2)
        told = program.end()
    assert told.code == exit_codes.DONE
    assert len(told.lines) == 2
    assert all(json.loads(line)["outcome"] == "ok" for line in told.lines)
    assert len(_logged(path)) == 2


def test_a_filter_chooses_what_is_shown_and_not_what_is_logged(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    tap = bench.tap()
    with Program("sniff", tap, "-w", path, "--where", "transaction_id == 2") as program:
        _ask(_tap_of(program), 3)
        told = program.end(signal.SIGINT)
    assert told.err.splitlines()[0] == "1 transaction: 1 ok"
    assert len(_logged(path)) == 3


def test_a_port_without_an_interface_is_told_to_have_no_effect(
    bench: Bench, mbtool: CommandLine
) -> None:
    told = mbtool("sniff", bench.tap(), "--port", "1502", "--duration", "0")
    assert "--port has no effect: it is for interfaces (net:), and there is none" in told.err


def test_stops_after_so_long(bench: Bench) -> None:
    with Program("sniff", bench.tap(), "--duration", "0.01") as program:
        told = program.end()
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines()[-1] == "0 transactions"


def test_the_end_of_time_is_no_error(bench: Bench) -> None:
    with Program("sniff", bench.tap(), "--duration", "inf", "--count", 1) as program:
        _ask(_tap_of(program), 1)
        assert program.end().code == exit_codes.DONE


def test_a_row_is_shown_as_soon_as_it_is_known(bench: Bench) -> None:
    with Program("sniff", bench.tap()) as program:
        tap = _tap_of(program)
        assert program.process.stdout is not None
        for number in (1, 2):
            _ask(tap, 1)
            line = ""
            while line.split()[:1] != [str(number)]:
                line = program.process.stdout.readline()
                assert line
            assert "06 write" in line
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED


def test_a_reader_that_goes_away_does_not_end_a_recording(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path) as program:
        tap = _tap_of(program)
        assert program.process.stdout is not None
        program.process.stdout.close()
        program.process.stdout = None
        _ask(tap, 1)
        said = program.await_said("nobody reads")
        _ask(tap, 2)
        told = program.end(signal.SIGINT)
    assert said == "mbtool: nobody reads standard output any more; the recording goes on\n"
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == f"3 transactions: 3 ok\nlog: {path}\n"
    assert len(_logged(path)) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_an_output_that_cannot_be_written_does_not_end_a_recording(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with (
        open("/dev/full", "w", encoding="utf-8") as full,
        Program("sniff", bench.tap(), "-w", path, stdout=full.fileno()) as program,
    ):
        tap = _tap_of(program)
        _ask(tap, 1)
        said = program.await_said("cannot be written")
        _ask(tap, 2)
        told = program.end(signal.SIGINT)
    assert said == (
        "mbtool: standard output: cannot be written: No space left on device; "
        "the recording goes on\n"
    )
    assert told.code == exit_codes.UNREADABLE
    assert told.err == f"3 transactions: 3 ok\nlog: {path}\n"
    assert len(_logged(path)) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_an_output_that_cannot_be_written_ends_a_run_without_a_log(bench: Bench) -> None:
    with (
        open("/dev/full", "w", encoding="utf-8") as full,
        Program("sniff", bench.tap(), stdout=full.fileno()) as program,
    ):
        _ask(_tap_of(program), 1)
        told = program.end()
    assert told.code == exit_codes.UNREADABLE
    assert told.err.endswith("standard output: cannot be written: No space left on device\n")


def test_a_reader_that_goes_away_ends_a_run_without_a_log(bench: Bench) -> None:
    with Program("sniff", bench.tap()) as program:
        tap = _tap_of(program)
        assert program.process.stdout is not None
        program.process.stdout.close()
        program.process.stdout = None
        _ask(tap, 1)  # Behind its answer the relay may end at any time.
        assert program.end().code == exit_codes.DONE


@pytest.mark.parametrize("format_", ["table", "jsonl"])
def test_a_reader_that_takes_nothing_holds_up_neither_the_log_nor_the_end(
    bench: Bench, tmp_path: Path, format_: str
) -> None:
    path = tmp_path / "a.mcap"
    with ExitStack() as stack:
        _, full = stack.enter_context(full_pipe())
        command = ("sniff", bench.tap(), "-w", path, "--format", format_)
        program = stack.enter_context(Program(*command, stdout=full))
        _ask(_tap_of(program), 50)
        found = (one for one in follow(path, patient()) if isinstance(one, NamedTransaction))
        assert len(list(islice(found, 50))) == 50
        told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    assert told.err == (
        "mbtool: standard output takes no text, so the last rows are not shown\n"
        f"50 transactions: 50 ok\nlog: {path}\n"
    )
    assert len(_logged(path)) == 50


def test_a_stopped_terminal_holds_up_neither_the_log_nor_the_end(
    bench: Bench, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    link, descriptor = bench.line(tmp_path)
    wait = patient()
    with (
        full_terminal() as full,
        Program("sniff", link, "-w", path, stdout=full, stderr=full) as program,
    ):
        while not path.exists():  # The log is begun when the line is open.
            wait()
        for _ in range(2):
            speak(descriptor, WRITE)
        found = (one for one in follow(path, wait) if isinstance(one, NamedTransaction))
        next(found)
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED
    assert len(_logged(path)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs flock")
def test_two_recorders_do_not_share_a_log(
    bench: Bench, tmp_path: Path, mbtool: CommandLine
) -> None:
    path = tmp_path / "a.mcap"
    with Program("sniff", bench.tap(), "-w", path) as program:
        _ask(_tap_of(program), 2)
        told = mbtool("sniff", bench.tap(), "-w", path, "--overwrite", "--duration", 0)
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err == (
        f"mbtool: {path}: another recorder is writing to it; name another, or end that one first\n"
    )
    assert len(_logged(path)) == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_device_is_no_log(bench: Bench, mbtool: CommandLine) -> None:
    told = mbtool("sniff", bench.tap(), "-w", "/dev/full", "--overwrite", "--duration", 0)
    assert told.code == exit_codes.USAGE
    assert told.err == ("mbtool: /dev/full: not a regular file; name another\n")
    assert Path("/dev/full").is_char_device()


def test_a_log_is_recorded_where_nobody_can_look_on(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    program = [sys.executable, "-c", "from mbtool.cli.main import main; main()"]
    arguments = ["sniff", str(bench.tap()), "-w", str(path), "--count", "2"]
    with subprocess.Popen(
        ["bash", "-c", 'exec "$@" >&-', "bash", *program, *arguments],
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        _ask(endpoint_in(process.stderr.readline()), 2)
        assert process.wait(PATIENCE_S) == exit_codes.DONE
    assert len(_logged(path)) == 2


def test_a_log_is_replaced_where_that_is_asked(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("old")
    with Program("sniff", bench.tap(), "-w", path, "--overwrite", "--duration", 0) as program:
        assert program.end().code == exit_codes.DONE
    assert _logged(path) == []


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["rtu:/dev/tty-no@auto", "-w", "old.mcap"], "the file exists"),
        (["rtu:/dev/tty-no@auto", "-w", "a.pcap"], "name it a.mcap"),
        (["rtu:/dev/tty-no@auto", "rtu:/dev/x/tty-no@auto"], "two links are called 'tty-no'"),
        (["rtu:/dev/tty-no@auto", "-w", "a.mcap", "--rotate", "often"], "rotation 'often'"),
        (["rtu:/dev/tty-no@auto", "-w", "a.mcap", "--keep", "3"], "--keep needs a log of several"),
        (["rtu:/dev/tty-no@auto", "--evidence-only"], "--evidence-only needs a log"),
    ],
)
def test_what_cannot_be_done_is_said_before_settings_are_looked_for(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    mbtool: CommandLine,
    arguments: list[str],
    why: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("old.mcap").touch()
    told = mbtool("sniff", *arguments)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert why in told.err
    assert "finding" not in told.err


def test_settings_that_were_found_are_said_and_logged(bench: Bench, tmp_path: Path) -> None:
    line, descriptor = bench.line(tmp_path)
    path = tmp_path / "a.mcap"
    done = Event()

    def poll() -> None:
        while not done.wait(0.06):
            speak(descriptor, WRITE)

    master = Thread(target=poll)
    master.start()
    try:
        with Program("sniff", f"rtu:{line.port}@auto", "-w", path, "--count", 3) as program:
            told = program.end()
    finally:
        done.set()
        master.join()
    assert told.code == exit_codes.DONE
    assert "finding the settings of tap by listening\ntap: 19200-8E1 RTU: " in told.err
    assert f"listening on rtu:{line.port}@19200-8E1;" in told.err
    with LogReader.open(path) as log:
        list(log.items())
        assert log.links["tap"]["spec"] == f"rtu:{line.port}@19200-8E1"


def test_a_line_that_cannot_be_read_is_told_while_it_is_heard(bench: Bench, tmp_path: Path) -> None:
    line, descriptor = bench.line(tmp_path)
    request, answer = bytes.fromhex("03 0000 0001"), bytes.fromhex("03 02 1234")
    frame = ascii_adu(1, request) + ascii_adu(1, answer)
    even = bytes(byte | byte.bit_count() % 2 << 7 for byte in frame)
    done = Event()

    def poll() -> None:
        while not done.wait(0.02):
            os.write(descriptor, even)

    master = Thread(target=poll)
    with Program("sniff", f"rtu:{line.port}@9600-8N1") as program:
        program.await_said("Ctrl-C ends")
        master.start()
        try:
            remark = program.await_said("can be read")
        finally:
            done.set()
            master.join()
        program.end(signal.SIGINT)
    assert "bytes none can be read with rtu@9600-8N1, so the settings are probably wrong" in remark
    assert f"; ascii:{line.port}@9600-7E1 fits these bytes (9600-7E1 ASCII: " in remark


def test_dtr_and_rts_are_for_serial_lines(mbtool: CommandLine) -> None:
    told = mbtool("sniff", "tap:127.0.0.1:0=127.0.0.1:1", "--dtr", "off")
    assert told.code == exit_codes.USAGE
    assert told.err == ("mbtool: --dtr and --rts are for serial lines; none of the links is one\n")


def test_a_line_that_the_driver_cannot_switch_off_ends_the_run(mbtool: CommandLine) -> None:
    with VirtualLine(ends=2, format=FAST) as line:
        told = mbtool("sniff", f"rtu:{line.ports[0]}@{FAST}", "--rts", "off")
    assert told.code == exit_codes.UNREADABLE
    assert "does not switch RTS off; leave out --rts off" in told.err
