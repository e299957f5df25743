"""Each code has a capture that shows it and one that nearly does, and its place in the docs."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest

from mbtool.cli import exit_codes
from mbtool.cli.main import run
from mbtool.core import Connection, Direction, Endpoint, InputError, SerialFormat
from mbtool.core.link_spec import parse_line
from mbtool.decode.connections import Bus, ConnectionDecoder, Decoded
from mbtool.devices import Assignments, builtin_profiles, load_profile
from mbtool.devices.assignment import Assignment, Who
from mbtool.devices.checking.capture_context import CaptureContext
from mbtool.devices.checking.checker import Checker
from mbtool.devices.checking.rules import RULES, DeviceCode, Rule, rule_of
from mbtool.devices.naming import Namer
from mbtool.devices.profile_checks import finding_prefix
from mbtool.modbus import Adu, Transaction
from mbtool.workflows.check import CheckRun
from mbtool.workflows.shared.reading import ReadingOptions
from tests.cases.worked_examples import WorkedExample, worked_examples
from tests.devices.transactions import transaction_of
from tests.feeding import START_NS, Line, feed_all
from tests.golden.findings_captures import Case, all_cases, files

if TYPE_CHECKING:
    from mbtool.devices.checking.finding import Finding

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "captures" / "findings"
PAGE = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")

EXPLAINED_VECTORS = {
    "exc-03": {"MB-101"},  # Its byte count is wrong on purpose, to get exception 03.
    "protocol-id-nonzero": {"TCP-103"},  # Its protocol id is wrong on purpose.
}
"""Why a worked example made by others breaks a rule."""

PORTS = {
    "port10502_stepping0.pcap": {"ports": [10502]},
    "rtu_over_tcp_flowmeter.pcap": {"rtu_ports": [8899]},
}
LINE = "rtu@9600-8N1"
LINES = {"brainchild-io-16do.bytes.csv": "rtu@19200-8E1"}
NEED_A_LINE = (".bytes.csv", ".bus.bin")

CASES = all_cases()
each_case = pytest.mark.parametrize("case", CASES, ids=lambda case: case.code)


def test_the_captures_are_those_that_the_program_makes() -> None:
    made = dict(files())
    assert {path.name for path in FOLDER.glob("*.pcap")} == set(made)
    for name, data in made.items():
        assert (FOLDER / name).read_bytes() == data, name


def test_every_code_has_its_captures() -> None:
    shown = {rule_of(case.code) for case in CASES}
    assert shown == set(RULES.values())


@each_case
def test_a_capture_shows_its_code_and_no_other_and_is_the_example_of_the_docs(
    case: Case, tmp_path: Path
) -> None:
    findings = checked(FOLDER / f"{case.code}.pcap", case, tmp_path, exit_codes.NO)
    assert {one["code"] for one in findings} == {case.code} | case.beside
    rule = rule_of(case.code)
    assert rule is not None
    message = next(one["message"] for one in findings if one["code"] == case.code)
    assert f"`{message}`" in section(rule)
    if DeviceCode.parse(case.code) is not None:
        assert f"Example: {case.code}, " in section(rule)


@each_case
def test_what_nearly_shows_a_code_does_not(case: Case, tmp_path: Path) -> None:
    code = exit_codes.NO if case.beside else exit_codes.DONE
    findings = checked(FOLDER / f"{case.code}-nearly.pcap", case, tmp_path, code)
    assert {one["code"] for one in findings} == case.beside


def test_the_docs_have_a_section_for_each_code_and_no_other() -> None:
    assert re.findall(r"^### (.+)$", PAGE, re.MULTILINE) == list(RULES)
    for rule in RULES.values():
        text = section(rule)
        assert f"**{rule.severity}**: {rule.meaning}\n" in text
        assert f"- Source: {rule.source}.\n" in text


def test_the_docs_name_the_prefix_of_every_device() -> None:
    for name in builtin_profiles():
        assert f"| {finding_prefix(load_profile(name))} |" in PAGE


@pytest.mark.parametrize(
    ("example", "device"),
    [(one, device) for one in worked_examples() if not one.foreign for device in one.devices],
    ids=str,
)
def test_a_worked_example_of_a_manual_breaks_no_rule(example: WorkedExample, device: str) -> None:
    assignments = Assignments([Assignment(Who(), load_profile(device))])
    checker = Checker(CaptureContext(assignments))
    named = Namer(assignments).name(transaction_of(example))
    found = {one.code for one in (*checker.feed(named), *checker.close())}
    expected = set(example.findings or ())
    # Here a request stands alone, and its reset is seen to be asked for.
    assert found - {"FA3-X3"} == expected


@pytest.mark.public_captures
def test_what_is_found_in_captures_made_by_others_is_what_the_docs_say(
    public_captures: Path,
) -> None:
    explained = explained_captures()
    seen = set()
    for path in sorted(public_captures.rglob("*")):
        place = f"{path.parent.name} {path.name}"
        if path.suffix in {".pcap", ".pcapng", ".gz"} or path.name.endswith(NEED_A_LINE):
            assert codes_of(path) == explained.get(place, set()), place
            seen.add(place)
    assert set(explained) <= seen  # No explanation outlives its capture.


@pytest.mark.public_captures
def test_a_worked_example_made_by_others_breaks_no_rule(public_captures: Path) -> None:
    file = public_captures.parent / "vectors.json"
    if not file.is_file():
        pytest.skip("no worked examples made by others beside the captures")
    examples: dict[tuple[str, str, str], dict[str, bytes]] = {}
    for one in msgspec.json.decode(file.read_bytes()):
        key = (one["device"], one["name"], one["transport"])
        examples.setdefault(key, {})[one["direction"]] = bytes.fromhex(one["hex"])
    looked_at = 0
    for (_, name, transport), sides in examples.items():
        # An answer that stands alone answers nothing, and a PDU has no line to be on.
        if "request" in sides and transport != "pdu":
            codes = {one.code for one in found_on_the_wire(transport, sides)}
            assert codes == EXPLAINED_VECTORS.get(name, set()), name
            looked_at += 1
    assert looked_at > 60


def found_on_the_wire(transport: str, sides: dict[str, bytes]) -> list[Finding]:
    """What is found in a request and its answer, sent as they stand."""
    decoded: list[Decoded]
    if transport == "tcp":
        talk = ConnectionDecoder(Connection(Endpoint("10.0.0.1", 50000), Endpoint("10.0.0.2", 502)))
        decoded = talk.feed(Direction.REQUEST, sides["request"], START_NS)
        decoded += talk.feed(Direction.RESPONSE, sides.get("response", b""), START_NS + 10**6)
        decoded += talk.close()
    else:
        format_ = SerialFormat.usual(is_ascii=transport == "ascii")
        line = Line(format_).send(sides["request"]).frame(sides.get("response", b""))
        decoded = feed_all(Bus("line", format_, ascii=transport == "ascii"), line.reads())
    checker, namer = Checker(), Namer()
    found: list[Finding] = []
    for one in decoded:
        if not isinstance(one, Adu):
            found += checker.feed(namer.name(one) if isinstance(one, Transaction) else one)
    return [*found, *checker.close()]


def checked(capture: Path, case: Case, folder: Path, code: int) -> list[dict[str, Any]]:
    """The findings of `mbtool check -o`, whose exit code must be this, but for troubles."""
    out = folder / "findings.json"
    ended = run(["check", str(capture), *case.options, "-o", str(out)])
    document = msgspec.json.decode(out.read_bytes())
    is_wrong = any(one["severity"] != "note" for one in document["troubles"])
    assert ended == (exit_codes.NO if is_wrong else code)
    found: list[dict[str, Any]] = document["findings"]
    return found


def codes_of(path: Path) -> set[str]:
    line = parse_line(LINES.get(path.name, LINE)) if path.name.endswith(NEED_A_LINE) else None
    options = ReadingOptions(line=line, **PORTS.get(path.name, {}))  # type: ignore[arg-type]
    codes = set()
    with suppress(InputError):
        for placed in CheckRun([str(path)], options).findings():
            codes.add(placed.finding.code)
    return codes


def explained_captures() -> dict[str, set[str]]:
    """The codes of each capture in the last table of the docs."""
    table = PAGE.partition("## On captures made by others")[2]
    explained: dict[str, set[str]] = {}
    for captures, codes in re.findall(r"^\| (.+?) \| ([A-Z0-9, -]+) \|", table, re.MULTILINE):
        for folder, name in re.findall(r"([\w-]+) `([^`]+)`", captures):
            explained[f"{folder} {name}"] = set(codes.split(", "))
    assert len(explained) > 15
    return explained


def section(rule: Rule) -> str:
    start = PAGE.index(f"### {rule.code}\n")
    following = re.compile(r"^##", re.MULTILINE).search(PAGE, start + 3)
    return PAGE[start : following.start() if following else len(PAGE)]
