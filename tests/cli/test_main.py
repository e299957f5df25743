"""The command line as a whole: help, wrong usage, wrong input, and streams that close."""

from __future__ import annotations

import ast
import gzip
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from mbtool import __version__
from mbtool.cli import exit_codes
from mbtool.sources.virtual_line import VirtualLine
from tests.cli.program import CommandLine, said
from tests.logs.samples import NAMED, transaction, write_log
from tests.workflows.bench import FAST
from tests.workflows.evidence import capture_file

ROOT = Path(__file__).resolve().parents[2]
SMALL = ROOT / "captures" / "plant.pcap"
COMMANDS = (
    "sniff",
    "status",
    "decode",
    "inventory",
    "check",
    "stats",
    "watch",
    "report",
    "plot",
    "convert",
    "recover",
    "replay",
    "diff",
    "slave",
    "read",
    "write",
    "poll",
    "scan",
    "test",
    "find",
    "devices",
    "links",
    "doctor",
    "line",
    "demo",
    "extcap",
)


def test_says_its_version(mbtool: CommandLine) -> None:
    assert mbtool("--version") == mbtool("--version")
    assert mbtool("--version").out == f"mbtool {__version__}\n"


def test_without_a_command_it_shows_five_to_begin_with(mbtool: CommandLine) -> None:
    told = mbtool()
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    shown = re.findall(r"^    mbtool (\w+)", told.err, re.MULTILINE)
    assert shown == ["sniff", "decode", "check", "report", "replay"]
    assert "mbtool --help lists all commands" in told.err
    assert max(map(len, told.err.splitlines())) <= 80


def test_help_lists_the_commands(mbtool: CommandLine) -> None:
    told = mbtool("--help")
    assert told.code == exit_codes.DONE
    listed = told.out.partition("Commands:\n")[2].splitlines()
    assert [line.split()[0] for line in listed] == list(COMMANDS)
    assert all(re.fullmatch(r"  \w+ +[A-Z].*\.", line) for line in listed)
    assert not any(line.endswith("...") for line in listed)


@pytest.mark.parametrize("command", COMMANDS)
def test_each_help_is_in_sentences_and_fits_a_terminal(mbtool: CommandLine, command: str) -> None:
    told = mbtool(command, "-h")
    assert told.code == exit_codes.DONE
    assert max(map(len, told.out.splitlines())) <= 80
    shown = told.out.partition("Options:\n")[2].partition("\nExamples:\n")[0]
    options = re.split(r"\n  (?=-)", re.sub(r"\n\n[A-Z].*:(?=\n)", "", shown))
    for option in options:
        text = " ".join(option.split())
        text = re.sub(r" \[.*?\](?= |$)", "", text)
        assert text.endswith((".", "HR400001 = 4660.")), text


def test_help_has_every_option_of_the_readme(mbtool: CommandLine) -> None:
    pages = (ROOT / "README.md", ROOT / "docs/commands.md", ROOT / "docs/filters.md")
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    used = {
        (command, option)
        for command, rest in re.findall(r"mbtool (\w+)([^\n`]*)", text)
        if command in COMMANDS
        for option in re.findall(
            r"(?<=\s)--?[a-z][a-z-]*", rest.partition("|")[0].partition("#")[0]
        )
    }
    assert ("sniff", "-w") in used
    for command, option in sorted(used):
        assert re.search(rf"[ ,]{option}[ ,\n]", mbtool(command, "--help").out), (command, option)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nonsense"], "No such command 'nonsense'; see mbtool --help"),
        (["--nonsense"], "No such option: --nonsense; see mbtool --help"),
        (
            ["decode"],
            "Missing argument 'FILE'; for example: mbtool decode plant.pcapng --where 'outcome != "
            '"ok"\'; see mbtool decode --help',
        ),
        (
            ["slave", "fa3-at1m8x"],
            "Missing option '--on'; for example: mbtool slave fa3-at1m8x --on tcp:127.0.0.1:1502; "
            "see mbtool slave --help",
        ),
        (["decode", "a", "--unit", "5"], "No such option: --unit; choose a unit with --where"),
        (["sniff", "a", "--baud", "9600"], "they are part of the LINK: rtu:"),
        (["line", "--baud", "9600"], "they are part of --settings 19200-8E1; see"),
        (["decode", "a", "--parity", "E"], "have them in --link rtu@19200-8E1; see"),
        (["check", "a", "--unit", "5"], "(Possible options: --limit); see mbtool check --help"),
        (
            ["devices", "--match"],
            "Option '--match' requires an argument; see mbtool devices --help",
        ),
        (["decode", "a", "--format", "xml"], "'xml' is not one of 'table', 'jsonl', 'csv'"),
        (["decode", "a", "--limit", "0"], "'0' is not at least 1; see mbtool decode"),
        (["decode", "a", "--port", "70000"], "Invalid value for '--port'"),
        (
            ["decode", "a", "--where", "unit ="],
            "--where 'unit =' is not an expression: write ==",
        ),
        (["decode", "a", "--device", "5"], "device '5': write WHO=PROFILE, for example"),
        (["decode", "a", "--device", "x=fa3-at1m8x"], "device 'x': WHO is 5, "),
        (["decode", "a", "--device", "5=pump"], "profile 'pump'"),
        (["decode", "a", "-o", "a.xlsx"], "a.xlsx: its suffix names no format"),
        (
            ["decode", "-", "-o", "absent/a.csv"],
            "absent/a.csv: cannot be written: there is no folder absent",
        ),
        (["decode", "a.csv", "-o", "a.csv"], "a.csv: is an input and would be overwritten"),
        (["decode", "a.csv", "-o", "./a.csv"], "./a.csv: is an input and would be overwritten"),
        (["decode", "-", "--format", "csv", "--events", "all"], "--events goes with table"),
        (["decode", "a", "b", "--follow"], "--follow goes with one log, and not with --raw"),
        (["decode", "a", "--follow", "--raw"], "--follow goes with one log, and not with --raw"),
        (["decode", "-", "--follow"], "--follow reads a log on disk, not standard input"),
        (["sniff", "usb0"], "link 'usb0': write rtu:PORT@19200-8E1, "),
        (["sniff", "tcp:[::1]:1502"], "before it (tap:127.0.0.1:1503=[::1]:1502) or capture"),
        (["sniff", "usb0"], "net:INTERFACE or tap:LISTEN=TARGET\n"),
        (
            ["slave", "fa3-at1m8x", "--on", "usb0"],
            "link 'usb0': write rtu:PORT@19200-8E1, ascii:PORT@9600-7E1, tcp:HOST:PORT, rtu+tcp:",
        ),
        (["sniff", "tap:127.0.0.1:1704=127.0.0.1:1704"], "the tap would call itself"),
        (["sniff", "tap:127.0.0.1:1704=127.0.0.1:0"], "nothing listens at port 0"),
        (["sniff", "rtu:/dev/ttyS0@99999999-8E1"], "no port has 99999999 baud; write 50 to"),
        (["line", "--settings", "1"], "no port has 1 baud; write 50 to 4000000"),
        (["decode", "a", "--where", 'outcome == "no_answer"'], "it is ok, exception, late,"),
        (["decode", "a", "--where", 'unit == "1"'], "unit is a number and '1' is a text"),
        (["sniff", "rtu:/dev/ttyUSB0@fast"], "line settings 'fast': write baud"),
        (["sniff", "tap:1502"], "link 'tap:1502': a tap needs where to listen"),
        (["sniff", "tcp:127.0.0.1:1502"], "put a tap before it"),
        (["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "--rotate", "1h"], "name one with -w FILE"),
        (
            ["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "-w", "absent/a.mcap"],
            "absent/a.mcap: cannot be created",
        ),
        (
            ["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "-w", "a.pcap"],
            "a.pcap: a log is an MCAP file: name it a.mcap",
        ),
        (
            ["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "-w", "."],
            ".: a directory; name a file in it, for example x.mcap",
        ),
        (["decode", "-", "-o", "."], ".: a directory; name a file in it"),
        (
            ["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "-w", "a.mcap", "--rotate", "often"],
            "rotation 'often': write a size in KB",
        ),
        (
            ["sniff", "tap:127.0.0.1:0=127.0.0.1:9", "tap:127.0.0.1:0=127.0.0.1:9"],
            "two links are called '127.0.0.1:9'",
        ),
        (["sniff", "rtu:a", "--duration", "-1"], "Invalid value for '--duration'"),
        (["slave", "pump", "--on", "tcp:127.0.0.1:0"], "profile 'pump'"),
        (["slave", "fa3-at1m8x", "--on", "tcp:0.0.0.0:0"], "that may connect: --allow 192.168"),
        (
            ["slave", "fa3-at1m8x", "--on", "tcp:0.0.0.0:0", "--allow", "10.0.0.0/33"],
            "--allow '10.0.0.0/33': write a network",
        ),
        (
            ["sniff", "tap:0.0.0.0:0=127.0.0.1:9", "--allow", "10.0.0.0/8", "--allow", "x"],
            "--allow 'x': write a network",
        ),
        (["sniff", "tap:0.0.0.0:0=127.0.0.1:9"], "other machines can reach 0.0.0.0"),
        (["sniff", "net:lo", "--allow", "10.0.0.0/8"], "--allow is for taps, and there is none"),
        (
            ["replay", "a", "--as-slave", "--on", "tcp:0.0.0.0:0", "--allow", "10.0.0.1/8"],
            "is an address inside 10.0.0.0/8; write 10.0.0.0/8",
        ),
        (["slave", "fa3-at1m8x", "--on", "net:lo"], "link net:lo: a slave needs rtu:PORT"),
        (
            ["slave", "fa3-at1m8x", "--on", "tcp:127.0.0.1:0", "--unit", "256"],
            "--unit: '256' is no unit",
        ),
        (["replay", "a", "--on", "tcp:127.0.0.1:0"], "say which side to play: --as-slave"),
        (["replay", "a", "--as-slave", "--on", "tcp:x:80000"], "port 80000 is above 65535"),
        (["replay", "a", "--as-slave", "--on", "tcp:x:y:z"], "is no address; write HOST:PORT"),
        (
            ["replay", "a", "--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "0"],
            "--speed '0': write a factor from 0.001 to 1000, or max",
        ),
        (
            ["replay", "a", "--as-slave", "--on", "tcp:127.0.0.1:0", "--speed", "nan"],
            "--speed 'nan': write",
        ),
        (
            ["replay", "a", "--as-slave", "--on", "tcp:127.0.0.1:0", "--on-miss", "x"],
            "'x' is not one of 'image', 'exception', 'silent'",
        ),
        (["devices", "pump"], "profile 'pump'"),
        (["line", "--settings", "fast"], "line settings 'fast': write baud"),
    ],
    ids=lambda one: " ".join(one) if isinstance(one, list) else "",
)
def test_wrong_usage_is_one_line_that_says_what_would_be_right(
    mbtool: CommandLine,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    problem: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    told = mbtool(*arguments)
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err.startswith("mbtool: ")
    assert told.err.count("\n") == 1
    assert problem in told.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (None, "there is no such file"),
        (b"", "empty; a capture has at least a header"),
        (b"hello\n", "a text file of 1 line, no capture; it shows no bytes, so there is nothing"),
        (b"PK\x03\x04" + bytes(60), "a zip archive, no capture"),
        (bytes(64), "a file that begins with 00 00 00 00"),
        (capture_file()[:3], "ends inside the first bytes of its header"),
        (capture_file()[:20], "ends"),
        (
            gzip.compress(capture_file(), mtime=0)[:30],
            "the compressed stream ends before its end mark",
        ),
    ],
)
@pytest.mark.parametrize("command", ["decode", "replay"])
def test_a_file_that_cannot_be_read_is_one_line(
    mbtool: CommandLine, tmp_path: Path, command: str, data: bytes | None, problem: str
) -> None:
    path = tmp_path / "a.pcap"
    if data is not None:
        path.write_bytes(data)
    more = ["--as-slave", "--on", "tcp:127.0.0.1:0"] if command == "replay" else []
    told = mbtool(command, path, *more)
    if command == "replay" and "end" in problem:
        # What comes before a cut is played; here it is nothing.
        assert told.code == exit_codes.UNREADABLE
        assert "no request to play an answer for" in told.err
        return
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err.startswith(f"mbtool: {path}: ")
    assert told.err.count("\n") == 1
    assert problem in told.err


def test_a_folder_is_no_capture(mbtool: CommandLine, tmp_path: Path) -> None:
    told = mbtool("decode", tmp_path)
    assert told.code == exit_codes.UNREADABLE
    assert (
        told.err
        == f"mbtool: {tmp_path}: no capture in this folder: no .pcap, .pcapng, .cap, .mcap\n"
    )


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read any file")
def test_a_file_that_may_not_be_read_is_one_line(mbtool: CommandLine, capture: Path) -> None:
    capture.chmod(0)
    told = mbtool("decode", capture)
    assert told.code == exit_codes.UNREADABLE
    assert "not permitted" in told.err


@pytest.mark.parametrize("command", ["sniff", "slave"])
def test_a_port_that_is_not_there_is_one_line_and_leaves_no_log(
    mbtool: CommandLine, tmp_path: Path, command: str
) -> None:
    link = f"rtu:{tmp_path}/absent@9600-8N1"
    if command == "sniff":
        told = mbtool("sniff", link, "-w", tmp_path / "a.mcap")
    else:
        told = mbtool("slave", "idec-ft1a-touch", "--on", link)
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert told.err.startswith(f"mbtool: serial port {tmp_path}/absent: is not there; ")
    assert told.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["sniff", "slave"])
def test_a_port_that_is_in_use_is_one_line(mbtool: CommandLine, command: str) -> None:
    fcntl = pytest.importorskip("fcntl")
    termios = pytest.importorskip("termios")
    with VirtualLine(ends=2, format=FAST) as line:
        port = line.ports[0]
        descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            fcntl.ioctl(descriptor, termios.TIOCEXCL)
            link = f"rtu:{port}"
            if command == "sniff":
                told = mbtool("sniff", link, "--duration", "0")
            else:
                told = mbtool("slave", "idec-ft1a-touch", "--on", link)
        finally:
            os.close(descriptor)
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert f"serial port {port}: is in use by another program" in told.err


@pytest.mark.parametrize("command", ["sniff", "slave"])
def test_an_address_in_use_is_one_line(mbtool: CommandLine, command: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"127.0.0.1:{server.getsockname()[1]}"
        if command == "sniff":
            told = mbtool("sniff", f"tap:{place}=127.0.0.1:9")
        else:
            told = mbtool("slave", "fa3-at1m8x", "--on", f"tcp:{place}")
    assert (told.code, told.out) == (exit_codes.UNREADABLE, "")
    assert place in told.err
    assert "in use" in told.err
    assert told.err.count("\n") == 1


@pytest.mark.parametrize("arguments", [["sniff", "tap:127.0.0.1:0=127.0.0.1:9"], ["demo"]])
def test_a_log_that_is_there_is_not_written_over(
    mbtool: CommandLine, tmp_path: Path, arguments: list[str]
) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("mine")
    told = mbtool(*arguments, "-w", path)
    assert told.code == exit_codes.USAGE
    assert "the file exists, and a recording is not overwritten" in told.err.splitlines()[-1]
    assert path.read_text() == "mine"


def _said_through(
    redirection: str, *arguments: object, limit: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a command by a shell that does something to its streams."""
    code = "from mbtool.cli.main import main; main()"
    return subprocess.run(
        [
            "bash",
            "-o",
            "pipefail",
            "-c",
            f'{limit}"$@" {redirection}',
            "bash",
            sys.executable,
            "-c",
            code,
        ]
        + [str(one) for one in arguments],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.parametrize("format_", ["table", "jsonl", "csv"])
def test_a_reader_that_has_seen_enough_ends_it(tmp_path: Path, format_: str) -> None:
    path = tmp_path / "a.pcap"
    path.write_bytes(capture_file(2000))
    ran = _said_through("| head -n 1", "decode", path, "--format", format_)
    assert ran.returncode == exit_codes.DONE
    assert ran.stdout.count("\n") == 1
    assert "Traceback" not in ran.stderr
    assert "Broken pipe" not in ran.stderr


@pytest.mark.parametrize(
    "arguments", [["devices"], ["devices", "fa3-at1m8x"], ["--help"], ["--version"]]
)
def test_a_pipe_that_nobody_reads_ends_it(arguments: list[str]) -> None:
    ran = _said_through("| true", *arguments)
    assert (ran.returncode, ran.stderr) == (exit_codes.DONE, "")


@pytest.mark.parametrize("more", [[], ["--format", "csv"], ["-o", "-"]])
def test_a_result_that_goes_nowhere_is_one_line(capture: Path, more: list[str]) -> None:
    ran = _said_through(">&-", "decode", capture, *more)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == (
        "mbtool: standard output: closed, so what goes there is lost; redirect it to a file\n"
    )
    assert _said_through(">&- 2>&-", "decode", capture, *more).returncode == exit_codes.UNREADABLE


def test_statistics_that_go_nowhere_are_one_line(capture: Path) -> None:
    ran = _said_through(">&-", "stats", capture)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr.startswith("mbtool: standard output: closed")


@pytest.mark.skipif(sys.platform != "linux", reason="file names of other systems are Unicode")
@pytest.mark.parametrize(
    "arguments",
    [
        ["decode", "--format", "jsonl"],
        ["decode", "--format", "csv"],
        ["stats", "--json"],
        ["inventory", "--format", "json"],
    ],
)
def test_a_file_name_that_is_no_utf_8_is_written_in_hex(
    mbtool: CommandLine, capture: Path, arguments: list[str]
) -> None:
    odd = os.fsencode(capture.parent) + b"/m\xfcller.pcap"
    os.rename(capture, odd)
    told = mbtool(*arguments, os.fsdecode(odd))
    assert told.code == exit_codes.DONE
    assert "xfcller.pcap" in told.out
    told.out.encode()  # Nothing in it is unfit for a file.


@pytest.mark.parametrize("redirection", [">&-", ">&- 2>&-", "2>&-"])
def test_closed_streams_are_no_error_where_a_file_gets_the_result(
    capture: Path, redirection: str
) -> None:
    path = capture.with_name("a.jsonl")
    ran = _said_through(redirection, "decode", capture, "-o", path)
    assert ran.returncode == exit_codes.DONE
    assert (ran.stdout, "Traceback" in ran.stderr) == ("", False)
    assert len(path.read_text().splitlines()) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("format_", ["table", "jsonl", "csv"])
def test_a_full_disk_is_one_line(capture: Path, format_: str) -> None:
    ran = _said_through("> /dev/full", "decode", capture, "--format", format_)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == "mbtool: standard output: cannot be written: No space left on device\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
@pytest.mark.parametrize("command", ["devices", "links", "--help", "--version"])
def test_a_full_disk_is_one_line_for_what_reads_no_file(command: str) -> None:
    ran = _said_through("> /dev/full", command)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == "mbtool: standard output: cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    "arguments",
    [["decode"], ["check"], ["diff"], ["devices", "--match"], ["devices", "draft"], ["replay"]],
)
def test_a_closed_standard_input_is_no_error_where_files_are_named(
    capture: Path, arguments: list[str]
) -> None:
    files = [capture, capture] if arguments == ["diff"] else [capture]
    more = ["--as-slave", "--on", "nonsense"] if arguments == ["replay"] else []
    ran = _said_through("<&-", *arguments, *files, *more)
    assert ran.returncode == (exit_codes.USAGE if more else exit_codes.DONE)
    assert "Traceback" not in ran.stderr


@pytest.mark.parametrize("arguments", [["decode", "-"], ["devices", "import", "-"]])
def test_a_closed_standard_input_is_one_line_where_it_is_to_be_read(arguments: list[str]) -> None:
    ran = _said_through("<&-", *arguments)
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == "mbtool: standard input: closed; name a file\n"


def test_too_few_files_that_may_be_open_is_one_line() -> None:
    ran = _said_through("", "line", "/nowhere/vl0", limit="ulimit -n 6; ")
    assert ran.returncode == exit_codes.UNREADABLE
    assert ran.stderr == "mbtool: too many files are open; allow more with `ulimit -n 1024`\n"


@pytest.mark.parametrize("more", [[], ["--all"]])
def test_a_reader_that_leaves_does_not_change_the_answer_of_check(more: list[str]) -> None:
    path = Path(__file__).resolve().parents[2] / "captures" / "findings" / "MB-103.pcap"
    ran = _said_through("| true; exit ${PIPESTATUS[0]}", "check", path, *more)
    assert ran.returncode == exit_codes.NO
    assert "Traceback" not in ran.stderr


def test_a_terminal_without_unicode_is_shown_what_it_can_show(tmp_path: Path) -> None:
    log = tmp_path / "a.mcap"
    write_log(log, [transaction(reference="27 \u2103")])
    told = said("decode", log, environment={"PYTHONIOENCODING": "ascii"})
    assert told.code == exit_codes.DONE
    assert r"27 \u2103" in told.out


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["decode", "--help"],
        ["sniff", "--help"],
        ["decode", "a.mcap"],
        ["decode", "a.mcap", "--format", "jsonl", "--where", "unit == 1"],
        ["stats", "small.pcap"],
        ["inventory", "small.pcap"],
    ],
)
def test_loads_only_what_it_uses(tmp_path: Path, arguments: list[str]) -> None:
    log = tmp_path / "a.mcap"
    write_log(log, [NAMED])
    files = {"a.mcap": str(log), "small.pcap": str(SMALL)}
    code = (
        "import sys\nfrom mbtool.cli.main import run\n"
        "code = run(sys.argv[1:])\n"
        "print(sorted(sys.modules))\n"
        "sys.exit(code)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, *(files.get(one, one) for one in arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    loaded = set(ast.literal_eval(ran.stdout.splitlines()[-1]))
    heavy = {"scapy", "numpy", "pyarrow", "textual", "serial", "asyncio", "pydantic", "email"}
    assert not loaded & heavy
    if arguments[0] == "decode":
        assert not loaded & {"mbtool.cli.sniff", "mbtool.cli.check", "tomllib", "statistics"}
        assert not loaded & {"mbtool.devices.importing.sunspec", "mbtool.sources.sigrok"}
    if "--format" in arguments:
        assert "rich" not in loaded
    if "--help" in arguments:
        assert not loaded & {"mcap", "rich", "msgspec", "zstandard"}
