"""The fixtures for tests of other programs; most tests run pytest in a folder of its own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import mbtool
from mbtool.pytest_plugin import log_name
from tests.api.masters import READ_TWO, master_of

if TYPE_CHECKING:
    from mbtool.pytest_plugin import MakesLine, MakesReplay, MakesSlave

pytest_plugins = ["pytester", "mbtool.pytest_plugin"]

CAPTURES = Path(__file__).parents[1] / "captures"

HEAD = """
from mbtool.pytest_plugin import log_name
from pymodbus.client import ModbusTcpClient
import pytest

def read(slave, address=0, count=2):
    with ModbusTcpClient(slave.host, port=slave.port, timeout=30) as client:
        return client.read_holding_registers(address, count=count, device_id=1)
"""


BODY = """
def test_polls_twice(mbtool_slave):
    slave = mbtool_slave("idec-ft1a-touch", image={"HR400001": [1, 2]})
    read(slave)
    slave.assert_asked("HR400001", times=2)

def test_asks_nobody(mbtool_slave):
    mbtool_slave("idec-ft1a-touch")
    assert False

def test_without_room_for_its_log(mbtool_slave, request):
    name = log_name(request.node.nodeid, 1)
    (request.config.getoption("--mbtool-logs") / name).mkdir(parents=True)
    read(mbtool_slave("idec-ft1a-touch"))
    assert False

@pytest.mark.parametrize("value", [1, 2, 3])
def test_passes(mbtool_slave, value):
    slave = mbtool_slave("idec-ft1a-touch", image={"HR400001": value})
    assert read(slave, count=1).registers == [value]
"""


def test_a_slave_answers_and_is_asked(mbtool_slave: MakesSlave) -> None:
    slave = mbtool_slave("idec-ft1a-touch", image={"HR400001": [1, 2]})
    with master_of(slave) as ask:
        assert ask(READ_TWO) == bytes.fromhex("03 04 0001 0002")
    slave.assert_asked("HR400001", times=1)
    assert slave.unanswered == []


def test_a_recording_answers(mbtool_replay: MakesReplay) -> None:
    replay = mbtool_replay(CAPTURES / "ft1a-touch-line.mcap", match="image", latency="none")
    with master_of(replay) as ask:
        assert ask(READ_TWO) == bytes.fromhex("03 04 0064 00c8")


def test_slaves_stand_on_the_ends_of_a_line(
    mbtool_line: MakesLine, mbtool_slave: MakesSlave
) -> None:
    line = mbtool_line("rtu@19200-8E1", ends=3)
    links = [mbtool_slave("idec-ft1a-touch", line.link(end), unit=end).link for end in (1, 2)]
    assert links == [f"rtu:{port}@19200-8E1" for port in line.ports[1:]]


def test_files_are_looked_for_beside_the_test(
    tmp_path: Path, mbtool_slave: MakesSlave, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = Path(__file__).with_name("no-such-file.toml")
    with pytest.raises(mbtool.InputError, match=image.name):
        mbtool_slave("idec-ft1a-touch", image=image.name)
    monkeypatch.chdir(tmp_path)
    (tmp_path / image.name).write_text("HR400001 = 3\n")
    assert mbtool_slave("idec-ft1a-touch", image=image.name)["HR400001"] == 3


def test_each_test_has_a_log_of_its_own() -> None:
    tests = [
        "a.py::t[x=1]",
        "a.py::t[x 1]",
        "a.py::t[x-1]",
        "a/py::t[x-1]",
        f"{'b' * 200}a.py::t[x]",
    ]
    names = {log_name(test, number) for test in tests for number in (1, 2)}
    assert len(names) == 10
    assert all(re.fullmatch(r"[\w.-]{1,120}", name) for name in names)
    assert log_name("a.py::t[x 1]", 1).startswith("a.py-t-x-1-")


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        ({"kind": "timeout"}, "'timeout' is none; write one of .*no-answer"),
        ({"kind": "exception", "code": 300}, "code: 300: write a number from 1 to 255"),
        ({"kind": "exception", "kode": 3}, "kode: .*did you mean code"),
        ({"kind": "delay"}, "ms: "),
    ],
)
def test_a_wrong_fault_is_told_without_the_calls_inside_mbtool(
    mbtool_slave: MakesSlave, keys: dict[str, Any], problem: str
) -> None:
    slave = mbtool_slave("idec-ft1a-touch")
    with pytest.raises(mbtool.UsageError, match=problem) as raised:
        slave.fault(**keys)
    assert [one.name for one in raised.traceback[1:]] == ["fault"]
    assert raised.value.__cause__ is None
    assert raised.value.__suppress_context__


def test_a_range_that_runs_backwards_is_told_so(mbtool_slave: MakesSlave) -> None:
    with pytest.raises(mbtool.UsageError, match="from the lower to the higher"):
        mbtool_slave("idec-ft1a-touch").assert_asked("holding 5..2")


def test_a_misspelt_argument_names_the_right_one(
    mbtool_slave: MakesSlave, mbtool_replay: MakesReplay
) -> None:
    with pytest.raises(TypeError, match=r"mbtool_replay\(\) .*'matches'; did you mean 'match'"):
        mbtool_replay(CAPTURES / "ft1a-touch-line.mcap", matches="image")
    with pytest.raises(TypeError, match=r"mbtool_slave\(\) .*'zzz'; there are .*image"):
        mbtool_slave("idec-ft1a-touch", zzz=1)


def test_a_condition_that_nothing_fits_is_named(mbtool_replay: MakesReplay) -> None:
    with pytest.raises(mbtool.InputError, match=r"none of its \d+ transactions fits .*where"):
        mbtool_replay(CAPTURES / "ft1a-touch-line.mcap", where="link == '9.9.9.9'")


def test_failing_tests_in_two_processes_keep_their_traffic_and_say_where(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    pytester.makepyfile(test_poll=HEAD + BODY)
    done = pytester.runpytest_subprocess(
        "-p", "mbtool.pytest_plugin", "-p", "xdist", "-n2", f"--mbtool-logs={pytester.path}/kept 2"
    )
    done.assert_outcomes(passed=3, failed=3)
    for lines in (
        ["E*AssertionError: HR400001: asked once, not 2 times. What was asked:"],
        [
            "*- Modbus traffic -*",
            "tcp:127.0.0.1:*: 1 request; mbtool decode '*/kept 2/*test_polls_twice-*-1.mcap'",
            "  *  unit 1  03 read HR400001..400002 -> 1, 2",
        ],
        ["tcp:127.0.0.1:*: no request came"],
        ["tcp:127.0.0.1:*: 1 request; no log was kept: *a directory*"],
    ):
        done.stdout.fnmatch_lines(lines)
    (log,) = (path for path in (pytester.path / "kept 2").iterdir() if path.is_file())
    (one,) = mbtool.open(log)
    assert (one.reference, one.response_values) == ("HR400001..400002", [1, 2])
