"""mbtool extcap, as Wireshark calls it."""

from __future__ import annotations

import signal
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.program import CommandLine

INTERFACE = ("--extcap-interface", "mbtool")


@pytest.mark.parametrize(
    ("asked", "begins"),
    [
        (("--extcap-interfaces", "--extcap-version=4.4"), "extcap {version="),
        ((*INTERFACE, "--extcap-dlts"), "dlt {number=228}"),
        ((*INTERFACE, "--extcap-config", "--of-a-newer-version"), "arg {number=0}{call=--port}"),
    ],
)
def test_it_answers_what_wireshark_asks(
    mbtool: CommandLine, asked: tuple[str, ...], begins: str
) -> None:
    told = mbtool("extcap", *asked)
    assert (told.code, told.err) == (exit_codes.DONE, "")
    assert told.out.startswith(begins)


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ((), exit_codes.USAGE, "give --install or --uninstall"),
        (("--capture", "--port", "/dev/x"), exit_codes.USAGE, "--capture goes with --fifo"),
        (("--capture", "--fifo", "x"), exit_codes.USAGE, "no serial port is chosen"),
        (("--capture", "--fifo", "x", "--port", "none"), exit_codes.USAGE, "no serial port is"),
        (
            ("--capture", "--fifo", "x", "--path", "/dev/x", "--baud", "9600", "--format", "9E1"),
            exit_codes.USAGE,
            "9E1",
        ),
        (
            ("--capture", "--fifo", "x", "--path", "/dev/x", "--mode", "tcp"),
            exit_codes.USAGE,
            "write rtu or ascii",
        ),
        (
            ("--capture", "--fifo", "x", "--path", "/dev/x", "--devices", "5=nothing"),
            exit_codes.USAGE,
            "profile 'nothing'",
        ),
        (
            ("--capture", "--fifo", "/absent/pipe", "--path", "/dev/x", "--baud", "9600"),
            exit_codes.UNREADABLE,
            "/absent/pipe: cannot be written",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    mbtool: CommandLine, options: tuple[str, ...], code: int, message: str
) -> None:
    told = mbtool("extcap", *options)
    assert told.code == code
    assert told.err.startswith("mbtool: ")
    assert message in told.err


def test_a_port_that_is_not_there_is_told(mbtool: CommandLine, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    line = ("--path", tmp_path / "absent", "--baud", "9600", "--device", "idec-ft1a-touch")
    told = mbtool("extcap", *INTERFACE, "--capture", "--fifo", pipe, *line)
    assert told.code == exit_codes.UNREADABLE
    assert "is not there" in told.err
    assert pipe.read_bytes() == b""


def test_it_is_installed_and_removed(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("APPDATA", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    told = mbtool("extcap", "--install")
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert files
    assert told.err.count("written: ") == len(files)
    assert mbtool("extcap", "--uninstall").err.count("removed: ") == len(files)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
    assert mbtool("extcap", "--uninstall").err == "nothing to remove\n"


def test_wireshark_can_end_it_while_the_settings_of_the_line_are_found(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    handlers: list[object] = []
    before = signal.getsignal(signal.SIGTERM)

    def found(links: list[object], _: object) -> list[object]:
        handlers.append(signal.getsignal(signal.SIGTERM))
        return links

    monkeypatch.setattr("mbtool.workflows.sniff.with_settings", found)
    line = ("--path", tmp_path / "absent", "--baud", "9600")
    mbtool("extcap", *INTERFACE, "--capture", "--fifo", tmp_path / "pipe", *line)
    assert handlers == [before]  # Not the one that only notes a signal, for a loop to see.
