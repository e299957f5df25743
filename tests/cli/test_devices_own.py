"""Profiles of the user's own."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from mbtool.cli import exit_codes
from mbtool.devices import builtin_profiles, load_profile, profile_schema
from tests.devices.sunspec import registers, write_models
from tests.workflows.evidence import capture_of, read

if TYPE_CHECKING:
    from tests.cli.program import CommandLine

CAPTURES = Path(__file__).parents[2] / "captures"
LIST = "Register;Name;Type;Scale\n40001;Speed;UINT16;0,1\n40002;State;INT16;1\n"


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_new_writes_a_start_that_loads(mbtool: CommandLine) -> None:
    told = mbtool("devices", "new", "pump 7.toml")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == (
        "pump 7.toml: written; edit it, and look at it with mbtool devices 'pump 7.toml'\n"
    )
    assert load_profile("./pump 7.toml").name == "pump-7"


@pytest.mark.parametrize(
    "arguments",
    [
        ["new", "there.toml"],
        ["import", "map.csv", "-o", "there.toml"],
        ["draft", CAPTURES / "broadcast-write.mcap", "-o", "there.toml"],
        ["export", "wago-750", "-o", "there.toml"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_nothing_is_written_over(mbtool: CommandLine, arguments: list[object]) -> None:
    Path("map.csv").write_text(LIST)
    Path("there.toml").write_text("mine")
    told = mbtool("devices", *arguments)
    assert told.code == exit_codes.USAGE
    assert (
        "there.toml: the file exists; name another, remove it, or replace it with --overwrite"
        in told.err
    )
    assert Path("there.toml").read_text() == "mine"


def test_a_profile_is_a_toml_file_in_a_folder_that_is_there(mbtool: CommandLine) -> None:
    assert "let its name end in .toml" in mbtool("devices", "new", "pump.txt").err
    told = mbtool("devices", "new", "nowhere/pump.toml")
    assert told.code == exit_codes.USAGE
    assert told.err == "mbtool: nowhere/pump.toml: cannot be written: there is no folder nowhere\n"


def test_import_writes_a_profile_and_tells_each_guess(mbtool: CommandLine) -> None:
    Path("map.csv").write_text(LIST)
    told = mbtool("devices", "import", "map.csv", "-o", "pump.toml")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err.splitlines() == [
        'column "Register" is taken for the address',
        'column "Name" is taken for the name',
        'column "Type" is taken for the type',
        'column "Scale" is taken for the scale',
        'numbers are multiplied by "Scale", as some factors are less than 1 '
        "(--scaling says otherwise)",
        "addresses are references, as every one of 40001..40002 can be one: 40001 is address 0 "
        "on the wire (--addresses says otherwise)",
        "rows 2-3: no access named, taken as read and write",
        "word order: high word first, as nothing says otherwise (--word-order)",
        "2 points -> pump.toml",
    ]
    profile = load_profile("pump.toml")
    assert (profile.name, [point.name for point in profile.points]) == ("pump", ["Speed", "State"])


def test_import_prints_where_no_file_is_named(
    mbtool: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("map.csv").write_text(LIST)
    printed = mbtool("devices", "import", "map.csv").out
    assert 'name = "map"' in printed
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(LIST.encode())))
    piped = mbtool("devices", "import", "-").out
    assert 'name = "Speed"' in piped


def test_import_tells_every_wrong_row_and_makes_nothing(mbtool: CommandLine) -> None:
    Path("map.csv").write_text(f"{LIST}40003;Start;DATETIME;1\n40007;Stop;DATETIME;x\n")
    told = mbtool("devices", "import", "map.csv", "-o", "pump.toml")
    assert told.code == exit_codes.USAGE
    assert told.err.splitlines() == [
        "map.csv: rows 4-5, column \"Type\": 'DATETIME' is no type, as UINT16, INT32, FLOAT32, "
        "BCD, BOOL or STRING[16] are",
        "map.csv: row 5, column \"Scale\": 'x' is no factor, as 0.1, /10 or x0.1 are",
        "mbtool: map.csv: 2 rows are wrong, so no profile was made (--skip-bad leaves them out)",
    ]
    assert not Path("pump.toml").exists()


def test_import_leaves_wrong_rows_out_if_that_is_said(mbtool: CommandLine) -> None:
    Path("map.csv").write_text(f"{LIST}40003;Start;DATETIME;1\n")
    told = mbtool("devices", "import", "map.csv", "-o", "pump.toml", "--skip-bad")
    assert told.code == exit_codes.DONE
    assert [line for line in told.err.splitlines() if line.startswith("left out")] == [
        "left out: row 4, column \"Type\": 'DATETIME' is no type, as UINT16, INT32, FLOAT32, BCD, "
        "BOOL or STRING[16] are"
    ]
    assert [point.name for point in load_profile("pump.toml").points] == ["Speed", "State"]


def test_import_guesses_nothing_that_is_said(mbtool: CommandLine) -> None:
    Path("map.csv").write_text("Nr;Wert;Format;Teiler;R/W\n40001;Speed;UINT32;10;R\n")
    columns = ("address=Nr", "name=Wert", "type=format", "scale=Teiler", "access=R/W")
    options = [word for one in columns for word in ("--column", one)]
    options += ["--addresses", "zero-based", "--table", "input", "--scaling", "multiply"]
    told = mbtool(
        "devices", "import", "map.csv", "-o", "pump.toml", "--word-order", "low-first", *options
    )
    assert told.err.splitlines() == [
        "word order: low word first, as --word-order says",
        "1 point -> pump.toml",
    ]
    (point,) = load_profile("pump.toml").points
    assert (point.name, point.table, point.address) == ("Speed", "input_registers", 40001)
    assert (point.scale, point.word_order) == (10, "low-first")


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (
            ["adress=Register"],
            "adress=Register: 'adress' is no meaning; these are: access,",
        ),
        (["Register"], "--column Register: is not MEANING=HEADING, as address=Register"),
        (["name="], "--column name=: is not MEANING=HEADING"),
        (["name=Name", "name=Type"], "--column name=Type: 'Name' is named for name already"),
        (["values=Name", "texts=Type"], "'Name' is named for texts already"),
        (["name=Name", "type=Name"], "'Name' is named for another meaning already"),
        (["type=Typ"], "map.csv: no column is headed 'Typ'; row 1 has 'Register', 'Name', 'Type'"),
    ],
)
def test_import_tells_what_is_wrong_with_a_column_that_is_named(
    mbtool: CommandLine, said: list[str], why: str
) -> None:
    Path("map.csv").write_text(LIST)
    told = mbtool("devices", "import", "map.csv", *(f"--column={one}" for one in said))
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert why in told.err
    assert len(told.err.splitlines()) == 1


def test_import_of_nothing_is_told(mbtool: CommandLine) -> None:
    told = mbtool("devices", "import", "nosuch.csv")
    assert told.code == exit_codes.UNREADABLE
    assert told.err == "mbtool: nosuch.csv: cannot be read: No such file or directory\n"


def test_draft_makes_a_profile_of_a_slave(mbtool: CommandLine) -> None:
    told = mbtool("devices", "draft", CAPTURES / "ft1a-touch-line.mcap", "-o", "touch.toml")
    assert told.code == exit_codes.DONE
    assert told.err.splitlines()[-1] == "unit 1: 4 areas, 5 points -> touch.toml"
    assert load_profile("touch.toml").title == "unit 1"


def test_draft_prints_where_no_file_is_named(mbtool: CommandLine) -> None:
    told = mbtool("devices", "draft", CAPTURES / "ft1a-touch-line.mcap", "--unit", "1")
    assert 'name = "unit-1"' in told.out
    assert told.err == ""


@pytest.mark.parametrize(
    ("unit", "said"),
    [("7", "no transaction of such a slave is there"), ("x", "WHO is 5"), ("300", "is no unit")],
)
def test_draft_of_a_slave_that_is_not_there_is_told(
    mbtool: CommandLine, unit: str, said: str
) -> None:
    told = mbtool("devices", "draft", CAPTURES / "ft1a-touch-line.mcap", "--unit", unit)
    assert told.code == exit_codes.USAGE
    assert said in told.err


@pytest.mark.parametrize(
    "capture", sorted(CAPTURES.glob("*.mcap")), ids=lambda capture: capture.stem
)
def test_the_drafts_of_a_capture_break_no_rule_in_it(mbtool: CommandLine, capture: Path) -> None:
    slaves = [
        json.loads(line)
        for line in mbtool("devices", "--match", capture, "--format", "jsonl").lines
    ]
    for slave in slaves:
        unit, host = slave["unit"], slave.get("destination", "").rpartition(":")[0]
        who = f"{host}/{unit}" if host else str(unit)
        own = f"own-{unit}.toml"
        assert mbtool("devices", "draft", capture, "--unit", who, "-o", own).code == 0
        lines = mbtool("decode", capture, "--device", f"{who}={own}", "--format", "jsonl").lines
        for one in map(json.loads, lines):
            findings = [code for code in one.get("findings", []) if code.startswith("OWN-")]
            # What the device refused is no part of its draft, and asking for it breaks a rule.
            assert not findings or "exception" in one


@pytest.mark.parametrize("name", builtin_profiles())
def test_export_prints_a_profile_that_loads_as_the_same(mbtool: CommandLine, name: str) -> None:
    Path("same.toml").write_text(mbtool("devices", "export", name).out, encoding="utf-8")
    assert load_profile("./same.toml") == load_profile(name)


def test_schema_prints_the_schema(mbtool: CommandLine) -> None:
    assert json.loads(mbtool("devices", "schema").out) == profile_schema()


def test_export_writes_other_forms_and_tells_what_they_lack(mbtool: CommandLine) -> None:
    told = mbtool("devices", "export", "fa3-th1m16y", "--telegraf", "--unit", "7", "-o", "fa3.conf")
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert "mbtool: without the texts of their values: Latest alarm code\n" in told.err
    assert "slave_id = 7" in Path("fa3.conf").read_text(encoding="utf-8")
    told = mbtool("devices", "export", "fa3-th1m16y", "--csv")
    assert told.lines[0].startswith("wire address,name,table,type")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "wago-750", "--csv", "--json"], "--csv and --json: choose one form"),
        (["export", "wago-750", "--csv", "-o", "a.toml"], "let its name end in .csv"),
        (["export", "wago-750", "--sunspec"], "wago-750: is no SunSpec model"),
        (["import", "a.csv", "--base", "0"], "--base goes with --sunspec"),
        (["import", "a.csv", "--unit", "5"], "--unit goes with --home-assistant"),
        (["import", "a.csv", "b.csv"], "b.csv: only --sunspec takes several files"),
        (["import", "a", "--sunspec", "--home-assistant"], "exclude each other"),
        (["import", "absent.json", "--sunspec"], "absent.json: cannot be read"),
    ],
)
def test_forms_that_do_not_go_together_are_refused(
    mbtool: CommandLine, arguments: list[str], message: str
) -> None:
    told = mbtool("devices", *arguments)
    assert told.code != exit_codes.DONE
    assert message in told.err


def test_sunspec_models_and_configurations_are_imported(mbtool: CommandLine) -> None:
    head = [{"name": "ID", "type": "uint16", "size": 1}, {"name": "L", "type": "uint16", "size": 1}]
    model = {"id": 1, "group": {"name": "pump", "points": head}}
    Path("pump.json").write_text(json.dumps(model), encoding="utf-8")
    told = mbtool("devices", "import", "--sunspec", "pump.json", "--base", "0", "-o", "pump.toml")
    assert told.code == exit_codes.DONE
    assert told.err.endswith("3 points -> pump.toml\n")
    assert mbtool("devices", "pump.toml").code == exit_codes.DONE
    hub = {"modbus": [{"sensors": [{"name": "A", "slave": 5, "address": 7}]}]}
    Path("ha.yaml").write_text(json.dumps(hub), encoding="utf-8")
    told = mbtool("devices", "import", "--home-assistant", "ha.yaml", "-o", "ha.toml")
    assert told.err == "1 point -> ha.toml\n"


def test_all_models_of_a_folder_are_tried(mbtool: CommandLine, tmp_path: Path) -> None:
    folder = write_models(tmp_path / "models")
    told = mbtool("devices", "import", "--sunspec", folder)
    assert (told.code, told.out) == (exit_codes.DONE, "")
    assert told.err == f"{folder}: 2 of 2 models can be imported\n"
    (folder / "model_9.json").write_text("{}")
    told = mbtool("devices", "import", "--sunspec", folder)
    assert told.code == exit_codes.USAGE
    assert "model_9.json: is no SunSpec model" in told.err
    told = mbtool("devices", "import", "--sunspec", folder, "-o", "all.toml")
    assert "no profile is written; a device has only some of them" in told.err


def test_a_sunspec_device_of_a_capture_is_drafted_and_named(
    mbtool: CommandLine, tmp_path: Path
) -> None:
    folder = write_models(tmp_path / "models")
    exchanges = [read(40039, [235]), *(read(*block) for block in registers().items())]
    Path("site.pcap").write_bytes(capture_of(exchanges))
    told = mbtool("decode", "site.pcap")
    assert "unit 1 at 10.0.0.2:502 is Maker Meter 7, SunSpec models 1, 64900, 64999" in told.err
    told = mbtool("decode", "site.pcap", "--sunspec", folder, "--full")
    assert "03 read 40039 -> meter.A: 235 x 10^meter.A_SF A" in told.out
    for text in ("meter.A: 23.5 A", "meter.phase[2].A: -8 A", "meter.phase[1].V: 230 V"):
        assert text in told.out
    assert "!" not in told.out
    told = mbtool("devices", "draft", "site.pcap", "--sunspec", folder, "-o", "meter.toml")
    assert told.err.endswith("16 points -> meter.toml\n")
    assert load_profile("./meter.toml").title == "Maker Meter 7"
    again = mbtool("decode", "site.pcap", "--device", "1=./meter.toml", "--full")
    assert "meter.phase[2].V: 231 V" in again.out
    assert "SunSpec" not in again.err


def test_a_new_profile_is_not_written_to_standard_output(mbtool: CommandLine) -> None:
    told = mbtool("devices", "new", "-")
    assert (told.code, told.out) == (exit_codes.USAGE, "")
    assert told.err == "mbtool: -: name the file to write, for example pump.toml\n"


@pytest.mark.parametrize(
    "command",
    [
        ["new", "OUT"],
        ["import", "list.csv", "-o", "OUT"],
        ["export", "wago-750", "-o", "OUT"],
        ["draft", "plant.pcap", "-o", "OUT"],
    ],
    ids=lambda one: one[0],
)
def test_a_profile_is_replaced_only_where_asked(
    mbtool: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("list.csv").write_text("address,name\n0,Speed\n")
    Path("plant.pcap").write_bytes(capture_of([read(0, [1, 2])]))
    Path("out.toml").write_text("mine")
    arguments = [one.replace("OUT", "out.toml") for one in command]
    told = mbtool("devices", *arguments)
    assert told.code == exit_codes.USAGE
    assert told.err.startswith("mbtool: out.toml: the file exists; ")
    assert Path("out.toml").read_text() == "mine"
    assert mbtool("devices", *arguments, "--overwrite").code == exit_codes.DONE
    assert load_profile("out.toml").name
