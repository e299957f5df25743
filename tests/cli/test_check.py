from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import run
from tests.captures import public_folder
from tests.columns.test_equality import poll
from tests.packets.building import Talk, pcap

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.cli.program import CommandLine

FOLDER = Path(__file__).resolve().parents[2] / "captures"
SHOWS = str(FOLDER / "findings" / "MB-103.pcap")
NEARLY = str(FOLDER / "findings" / "MB-103-nearly.pcap")
LOG = str(FOLDER / "ft1a-touch-line.mcap")


def test_findings_are_an_answer_of_no(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", SHOWS]) == exit_codes.NO
    captured = capsys.readouterr()
    refused, findings = captured.out.split("\n", 1)
    assert refused == (
        "! unit 1 refuses 05 coil 0 (once), with 03 illegal data value: correct the quantity or "
        "value of the request by its manual (UNIT-REFUSES)"
    )
    assert findings == (
        "MB-103  error  1 time  10.0.0.2 unit 1\n"
        "    2026-01-01 00:00:00.056: write coil 0: value 0001H for a coil\n"
    )
    assert captured.err == (
        "1 trouble, 1 finding in 3 transactions; docs/troubles.md and docs/findings.md explain the "
        "codes\n"
    )


def test_a_baseline_is_read_first_and_must_have_transactions(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    alone, told = mbtool("check", SHOWS), mbtool("check", SHOWS, "--baseline", NEARLY)
    unused = "the checked captures have no request of the baseline; it was not used\n"
    assert (told.code, told.out, told.err) == (alone.code, alone.out, alone.err + unused)
    empty = tmp_path / "empty.pcap"
    empty.write_bytes(pcap([]))
    told = mbtool("check", SHOWS, "--baseline", str(empty))
    assert told.code == exit_codes.UNREADABLE
    assert told.err == f"mbtool: {empty}: no transaction in it to compare with\n"
    told = mbtool("check", SHOWS, "--baseline", str(tmp_path / "absent.pcap"))
    assert (told.code, told.err.count("\n")) == (exit_codes.UNREADABLE, 1)


def test_no_findings_are_an_answer_of_yes(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", NEARLY]) == exit_codes.DONE
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == (
        "",
        "no findings in 3 transactions. Too short to judge in 105 ms: the unit answers 3 requests, "
        "half of them within 1.0 ms; no trouble shows.\n",
    )


def test_requests_without_a_good_answer_are_told_though_they_break_no_rule(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    refused = str(FOLDER / "polling-with-exceptions.mcap")
    assert run(["check", refused, "--select", "SEC"]) == exit_codes.DONE
    assert capsys.readouterr().err.startswith("no findings in ")
    assert run(["check", refused]) == exit_codes.NO
    assert capsys.readouterr().out.startswith("! unit 1 refuses ")
    silent = str(FOLDER / "plant.pcap")
    told = tmp_path / "told.json"
    assert run(["check", silent, refused, "-o", str(told)]) == exit_codes.NO
    assert json.loads(told.read_text())["failed_requests"] == {
        "late": 0, "no_answer": 1, "wrong_crc": 0, "exception": 5, "malformed": 0,
    }  # fmt: skip


@pytest.mark.public_captures
def test_notes_are_said_to_leave_the_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    path = public_folder() / "yakuter__go-dpi-packet/modbus.pcap"
    if not path.exists():
        pytest.skip("no captures of others")
    assert run(["check", str(path)]) == exit_codes.DONE
    assert capsys.readouterr().err.startswith(
        "1 trouble of severity note (exit code 0) in 1 transaction;"
    )


def test_each_finding_can_be_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", LOG, "--all"]) == exit_codes.NO
    captured = capsys.readouterr()
    assert captured.out.startswith(
        "2026-11-21 19:39:41.268  FT1A-F15   rs485 unit 1: the device has no write multiple coils\n"
        "2026-11-21 19:39:41.332  FT1A-A3    rs485 unit 1: read holding HR404096..404097: "
        "not an address that one can read\n"
    )
    assert captured.err.startswith("1 trouble, 2 findings of 2 codes in 11 transactions;")


def test_what_is_ignored_is_no_answer_of_no(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", LOG, "--ignore", "FT1A-F,FT1A-A"]) == exit_codes.DONE
    assert run(["check", LOG, "--select", "RTU", "--select", "TCP"]) == exit_codes.DONE
    capsys.readouterr()
    assert run(["check", LOG, "--select", "FT1A-A3", "--ignore", "FT1A"]) == exit_codes.NO
    assert capsys.readouterr().out.startswith("FT1A-A3 ")


def test_a_limit_says_from_where_on_something_is_a_scan(
    capsys: pytest.CaptureFixture[str],
) -> None:
    nearly = str(FOLDER / "findings" / "SEC-202-nearly.pcap")
    assert run(["check", nearly]) == exit_codes.DONE
    limits = ["--limit", "sec-202=9/1min", "--limit", "SEC-201=2/5s"]
    capsys.readouterr()
    assert run(["check", nearly, *limits]) == exit_codes.NO
    assert capsys.readouterr().out.partition("\n")[2] == (
        "SEC-202  warning  9 times  10.0.0.2\n"
        "    2026-01-01 00:00:00.004: "
        "10.0.0.1 asks 9 units of 10.0.0.2:502 and polls none of them: 1, 2, 3, ...\n"
    )
    assert run(["check", nearly, *limits, "--ignore", "SEC"]) == exit_codes.DONE


def test_attacks_are_in_documents(tmp_path: Path) -> None:
    shows = str(FOLDER / "findings" / "SEC-201.pcap")
    assert run(["check", shows, "-o", str(tmp_path / "x.json")]) == exit_codes.NO
    (finding,) = json.loads((tmp_path / "x.json").read_text())["findings"]
    assert (finding["code"], finding["count"], finding["severity"]) == ("SEC-201", 10, "warning")
    assert finding["source"].startswith("10.0.0.9:")
    assert "unit" not in finding
    assert run(["check", shows, "-o", str(tmp_path / "x.sarif")]) == exit_codes.NO
    (run_,) = json.loads((tmp_path / "x.sarif").read_text())["runs"]
    (result,) = run_["results"]
    assert (result["ruleId"], result["occurrenceCount"]) == ("SEC-201", 10)


@pytest.mark.parametrize(("name", "key"), [("x.json", "findings"), ("x.sarif", "runs")])
def test_the_name_of_the_output_says_the_format(
    name: str, key: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / name
    assert run(["check", SHOWS, "-o", str(out)]) == exit_codes.NO
    assert key in json.loads(out.read_text())
    captured = capsys.readouterr()
    assert captured.out == ""
    assert f"explain the codes -> {out}\n" in captured.err


def test_a_document_goes_to_standard_output_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", SHOWS, "--format", "json"]) == exit_codes.NO
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert (finding["code"], finding["file"]) == ("MB-103", SHOWS)


def test_a_table_goes_to_a_text_file(tmp_path: Path) -> None:
    assert run(["check", SHOWS, "-o", str(tmp_path / "x.txt")]) == exit_codes.NO
    assert "\nMB-103  error" in (tmp_path / "x.txt").read_text()


def test_a_cut_capture_leaves_a_whole_document(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut, out = tmp_path / "cut.pcap", tmp_path / "x.sarif"
    cut.write_bytes(Path(SHOWS).read_bytes()[:-5])
    assert run(["check", str(cut), "-o", str(out)]) == exit_codes.UNREADABLE
    (run_,) = json.loads(out.read_text())["runs"]
    assert [one["ruleId"] for one in run_["results"]] == ["MB-103", "UNIT-REFUSES"]
    said = capsys.readouterr().err.splitlines()
    assert said[0].startswith("1 trouble, 1 finding in ")
    assert said[-1].startswith(f"mbtool: {cut}: ends in the middle of a record")


def test_the_json_of_a_cut_capture_says_that_it_is_not_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.pcap"
    cut.write_bytes(Path(SHOWS).read_bytes()[:-5])
    assert run(["check", str(cut), "--format", "json"]) == exit_codes.UNREADABLE
    document = json.loads(capsys.readouterr().out)
    assert document["is_whole"] is False
    assert document["remarks"][-1].startswith(f"{cut}: ends in the middle of a record")
    assert run(["check", SHOWS, "--format", "json"]) == exit_codes.NO
    document = json.loads(capsys.readouterr().out)
    assert (document["is_whole"], document["remarks"]) == (True, [])


@pytest.mark.parametrize("suffix", ["json", "sarif", "txt"])
@pytest.mark.parametrize("is_old", [True, False])
def test_ctrl_c_leaves_no_file_that_looks_complete(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    suffix: str,
    *,
    is_old: bool,
) -> None:
    out = tmp_path / f"x.{suffix}"
    if is_old:
        out.write_text("older")
    monkeypatch.setattr("mbtool.cli.check.with_progress", _interrupted)
    assert run(["check", SHOWS, "-o", str(out), "--overwrite"]) == exit_codes.INTERRUPTED
    kept = f"{out} stays as it was" if is_old else "nothing was written"
    assert capsys.readouterr().err == f"interrupted; {kept}\n"
    assert out.exists() == is_old
    assert not is_old or out.read_text() == "older"


def test_ctrl_c_prints_what_was_found_and_marks_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mbtool.cli.check.with_progress", _interrupted)
    assert run(["check", SHOWS, "--format", "json"]) == exit_codes.INTERRUPTED
    told = capsys.readouterr()
    document = json.loads(told.out)
    assert (document["is_whole"], document["remarks"]) == (False, ["interrupted"])
    assert told.err.startswith("interrupted; what follows from the rest of the files is not there")


def _interrupted(_: object, records: Iterator[object]) -> Iterator[object]:
    yield next(records)
    raise KeyboardInterrupt


@pytest.mark.parametrize("suffix", ["json", "sarif", "txt"])
def test_what_cannot_be_read_at_all_leaves_no_document(tmp_path: Path, suffix: str) -> None:
    broken, out = tmp_path / "broken.pcap", tmp_path / f"x.{suffix}"
    broken.write_bytes(Path(SHOWS).read_bytes()[:30])
    assert run(["check", str(broken), "-o", str(out)]) == exit_codes.UNREADABLE
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([SHOWS, "--select", "RUT"], "no code begins with 'RUT'; they begin with FA3, FT1A, "),
        ([SHOWS, "-o", "x.csv"], "x.csv: its suffix names no format; let it end in .txt, .json, "),
        ([SHOWS, "-o", str(FOLDER)], ": a directory; name a file in it"),
        ([SHOWS, "-o", SHOWS], "is an input and would be overwritten"),
        ([SHOWS, SHOWS], "named twice"),
        ([SHOWS, "--port", "502", "--limit", "x"], "--limit: 'x' is no limit; write CODE=NUMBER/"),
        ([SHOWS, "--device", "5"], "device '5'"),
        ([SHOWS, "--limit", "SEC-201=20"], "--limit: 'SEC-201=20' is no limit; write CODE=NUMBER/"),
        ([SHOWS, "--limit", "SEC-9=1/1s"], "--limit: 'SEC-9' has no limit; those that have: SEC-"),
        ([SHOWS, "--limit", "SEC-201=0/1s"], "the number is from 1 to 4096"),
        ([SHOWS, "--limit", "SEC-201=9/2d"], "--limit: 'SEC-201=9/2d' is no limit"),
        ([LOG, "--link", "rtu"], "--link is not for a log"),
    ],
)
def test_a_wrong_word_is_told_in_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["check", *arguments]) == exit_codes.USAGE
    captured = capsys.readouterr()
    assert captured.out == ""
    assert says in captured.err
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize(
    ("window", "place"),
    [
        (["--start", "2h"], "after --start"),
        (["--end", "2020-01-01"], "before --end"),
        (["--start", "2020-01-01", "--end", "2020-01-02"], "between --start and --end"),
    ],
)
def test_a_window_without_a_transaction_is_told_and_not_taken_for_a_clean_one(
    window: list[str], place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("check", "decode"):
        assert run([command, SHOWS, *window]) == exit_codes.DONE
        said = capsys.readouterr().err
        assert f"no transaction {place}: the first is of 2026-" in said
        assert "no findings" not in said


def test_what_could_not_be_read_is_not_told_as_clean(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.pcap"
    broken.write_bytes(Path(SHOWS).read_bytes()[:30])
    assert run(["check", str(broken)]) == exit_codes.UNREADABLE
    assert "no findings" not in capsys.readouterr().err
    broken.write_bytes(Path(NEARLY).read_bytes()[:-1])
    assert run(["check", str(broken)]) == exit_codes.UNREADABLE
    assert "no findings in " in capsys.readouterr().err


def test_an_absent_capture_is_unreadable_and_costs_no_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "kept.json"
    out.write_text("kept")
    arguments = ["check", str(tmp_path / "absent.pcap"), "-o", str(out)]
    assert run(arguments) == exit_codes.UNREADABLE
    assert out.read_text() == "kept"
    assert "absent.pcap" in capsys.readouterr().err


def test_a_capture_without_modbus_is_said_to_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.pcap"
    empty.write_bytes(Path(SHOWS).read_bytes()[:24])
    assert run(["check", str(empty)]) == exit_codes.DONE
    assert "empty; there is neither a packet nor a transaction in it" in capsys.readouterr().err


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("format_", ["table", "json", "sarif"])
def test_a_full_disk_is_told(format_: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["check", SHOWS, "--format", format_, "-o", "/dev/full"]
    assert run(arguments) == exit_codes.UNREADABLE
    said = "mbtool: /dev/full: cannot be written: No space left on device\n"
    assert capsys.readouterr().err == said


def test_a_closed_standard_output_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.__stdout__", None)
    assert run(["check", SHOWS]) == exit_codes.UNREADABLE
    assert "standard output: closed, so what goes there is lost" in capsys.readouterr().err


def test_a_choice_that_leaves_nothing_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", LOG, "--select", "SEC,mb-1", "--ignore", "mb-1,SEC"]) == exit_codes.USAGE
    said = "mbtool: --ignore MB-1,SEC leaves out all that --select chooses\n"
    assert capsys.readouterr().err == said


def test_sarif_may_be_named_json(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = str(tmp_path / "a.json")
    assert run(["check", LOG, "--format", "sarif", "-o", out]) == exit_codes.NO
    assert "written as" not in capsys.readouterr().err
    assert run(["check", LOG, "--format", "json", "-o", f"{out}.sarif"]) == exit_codes.NO
    assert "written as json, as --format says" in capsys.readouterr().err


def test_troubles_are_failed_tests_of_junit(tmp_path: Path) -> None:
    out = tmp_path / "x.xml"
    assert run(["check", SHOWS, "-o", str(out)]) == exit_codes.NO
    suite = ElementTree.parse(out).getroot()
    names = [case.attrib["name"] for case in suite.iter("testcase")]
    assert names == ["MB-103 unit 1", "UNIT-REFUSES unit 1"]
    assert suite.attrib["failures"] == "2"
    assert run(["check", NEARLY, "-o", str(out), "--overwrite"]) == exit_codes.DONE
    suite = ElementTree.parse(out).getroot()
    assert suite.attrib["failures"] == "0"
    (case,) = suite.iter("testcase")
    assert case.attrib["name"].startswith("Too short to judge")


def test_of_many_clean_files_one_line_is_said(mbtool: CommandLine, tmp_path: Path) -> None:
    talk = Talk()
    for number in range(25):
        (tmp_path / f"{number}.pcap").write_bytes(pcap([*talk.handshake(), *poll(talk, 20)]))
    told = mbtool("check", tmp_path)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.startswith("no findings in 500 transactions. Everything is well")
    assert len(told.err.splitlines()) == 1


def test_of_many_files_only_those_with_a_remark_are_listed(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    talk = Talk()
    data = pcap([*talk.handshake(), *poll(talk, 20)])
    for number in range(25):
        (tmp_path / f"{number}.pcap").write_bytes(data[:-5] if number == 7 else data)
    told = mbtool("check", tmp_path / "*.pcap")
    assert told.code == exit_codes.UNREADABLE
    listed = [line for line in told.err.splitlines() if ".pcap  " in line]
    assert [line.split()[0] for line in listed] == [str(tmp_path / "7.pcap")]
    assert "read in part: " in listed[0]
