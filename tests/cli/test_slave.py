"""mbtool slave, until a signal."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import run
from mbtool.core import TcpLink
from mbtool.master.links import open_master
from tests.cli.program import Program, endpoint_in, said
from tests.sources.live_helpers import MASTER_TIMEOUT_NS
from tests.workflows.evidence import READ, VALUES

RECORDING = Path(__file__).resolve().parents[2] / "captures" / "ft1a-touch-line.mcap"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_slave_says_where_it_is_and_answers_until_a_signal(tmp_path: Path, number: int) -> None:
    image = tmp_path / "start.toml"
    image.write_text("HR400001 = [4660, 22136]\n")
    link = "tcp:127.0.0.1:0"
    with Program("slave", "idec-ft1a-touch", "--on", link, "--image", image) as program:
        began = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(began)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(1, READ) == VALUES
        told = program.end(number)
    assert began.startswith("FT1A Touch operator interface, Modbus RTU slave as unit 1 on tcp:")
    assert (told.code, told.out, told.err) == (exit_codes.INTERRUPTED, "", "")


def test_it_shows_exchanges_and_outputs_and_keeps_its_state(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    link = "tcp:127.0.0.1:0"
    arguments = ("slave", "fa3-th1m16y", "--on", link, "--print", "--state", state)
    with Program(*arguments) as program:
        began = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(began)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(0, bytes.fromhex("05 0001 FF00")) is not None
            assert master.ask(0, bytes.fromhex("06 00F5 0007")) is not None
            program.await_said("outputs: Y1 on")
        told = program.end(signal.SIGINT)
    assert told.code == exit_codes.INTERRUPTED
    _, _, first, second = told.out.splitlines()
    assert first.endswith("05 write Y1: on")
    assert second.endswith("06 write 00F5H Split reception monitoring timer: 7 s")
    assert "00F5H = 7\n" in state.read_text()


@pytest.mark.parametrize(
    "command", [("slave", "idec-ft1a-touch"), ("replay", RECORDING, "--as-slave")]
)
def test_a_reader_that_goes_away_does_not_end_a_slave(command: tuple[object, ...]) -> None:
    with Program(*command, "--on", "tcp:127.0.0.1:0", "--print") as program:
        began = program.await_said("Ctrl-C ends")
        assert program.process.stdout is not None
        program.process.stdout.close()
        program.process.stdout = None
        with open_master(TcpLink(endpoint_in(began)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(1, READ) is not None
            said = program.await_said("nobody reads")
            assert master.ask(1, READ) is not None
        assert program.end(signal.SIGINT).code == exit_codes.INTERRUPTED
    assert said == "mbtool: nobody reads standard output any more; the slave goes on\n"


def test_a_state_for_a_device_that_keeps_nothing_is_refused(tmp_path: Path) -> None:
    state = tmp_path / "state.toml"
    told = said("slave", "idec-ft1a-touch", "--on", "tcp:127.0.0.1:0", "--state", state)
    assert told.code == exit_codes.USAGE
    assert (
        told.err == "mbtool: idec-ft1a-touch keeps nothing over a restart, so --state has no use\n"
    )


def test_several_devices_answer_on_one_link_each_with_its_values(tmp_path: Path) -> None:
    first, other = tmp_path / "first.toml", tmp_path / "other.toml"
    first.write_text("HR400001 = [4660, 22136]\n")
    other.write_text("40001 = { ramp = [5, 6], seconds = 10000 }\n")
    with Program(
        *("slave", "idec-ft1a-touch", "--on", "tcp:127.0.0.1:0", "--unit", "7", "--print"),
        *("--unit", "3=chino-lt830", "--image", first, "--image", f"3={other}"),
    ) as program:
        began = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(began)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(7, READ) == VALUES
            assert master.ask(3, READ) == bytes.fromhex("03 04 0005 0000")
        told = program.end(signal.SIGINT)
    assert "slave as unit 7, LT830 digital indicating controller as unit 3 on tcp:" in began
    _, _, first_row, other_row = told.out.splitlines()
    assert "HR400001..400002" in first_row
    assert "40001..40002" in other_row


def test_faults_of_a_file_are_shown_on_purpose(tmp_path: Path) -> None:
    fault = tmp_path / "fault.toml"
    fault.write_text('[[faults]]\nkind = "exception"\ncode = 6\n')
    link = "tcp:127.0.0.1:0"
    with Program("slave", "idec-ft1a-touch", "--on", link, "--fault", fault) as program:
        began = program.await_said("Ctrl-C ends")
        with open_master(TcpLink(endpoint_in(began)), MASTER_TIMEOUT_NS) as master:
            assert master.ask(1, READ) == bytes.fromhex("83 06")
        assert program.end(signal.SIGINT).err == ""


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (
            ["--on", "tcp:127.0.0.1:1"],
            "--on tcp:127.0.0.1:1: a slave has one link, here tcp:127.0.0.1:0",
        ),
        (["--unit", "256"], "--unit: '256' is no unit; write a number from 0 to 255, or 3=PROFILE"),
        (["--unit", "x"], "--unit: 'x' is no unit; write a number"),
        (["--unit", "1", "--unit", "2"], "unit 1 already; write 2=PROFILE for another one"),
        (["--unit", "1=wago-750"], "unit 1 is the first device; choose another"),
        (["--unit", "3=wago-750", "--unit", "3=chino-lt830"], "unit 3 has a profile already"),
        (["--unit", "3=absent"], "absent"),
        (["--image", "3=x.toml"], "--image 3=x.toml: no device is unit 3; see --unit"),
        (["--image", "a", "--image", "b"], "--image b: unit 1 has a file already; join the two"),
    ],
)
def test_units_and_files_that_do_not_fit_are_refused_in_a_line(
    arguments: list[str], says: str
) -> None:
    told = said("slave", "idec-ft1a-touch", "--on", "tcp:127.0.0.1:0", *arguments)
    assert told.code == exit_codes.USAGE
    assert says in told.err
    assert told.err.count("\n") == 1


def test_strict_timing_is_for_rtu_lines(capsys: pytest.CaptureFixture[str]) -> None:
    on = ["--on", "tcp:127.0.0.1:0", "--strict-timing"]
    assert run(["slave", "idec-ft1a-touch", *on]) == exit_codes.USAGE
    assert "strict timing is for RTU lines" in capsys.readouterr().err
