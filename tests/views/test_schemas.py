"""SARIF and JUnit of check, against the schemas of OASIS and of Jenkins.

sarif-schema-2.1.0.json is in github.com/oasis-tcs/sarif-spec, junit-10.xsd in
github.com/jenkinsci/xunit-plugin.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from jsonschema import Draft4Validator

from mbtool.cli.main import run
from mbtool.views.junit import Case, junit_xml

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = Path(os.environ.get("MBTOOL_SCHEMAS") or ROOT.parent / "shared" / "schemas")
FINDINGS = ROOT / "captures" / "findings"
CAPTURES = {
    "findings": [FINDINGS / "SEC-201.pcap", FINDINGS / "RTU-201.pcap", FINDINGS / "MB-401.pcap"],
    "troubles": [ROOT / "captures" / "plant.pcap"],
    "nothing wrong": [FINDINGS / "MB-103-nearly.pcap"],
}


def schema(name: str) -> Path:
    path = SCHEMAS / name
    if not path.exists():
        pytest.skip(f"needs {name} in {SCHEMAS}")
    return path


@pytest.mark.parametrize("kind", CAPTURES)
def test_sarif_is_valid_by_the_schema_of_oasis(kind: str, tmp_path: Path) -> None:
    rules = json.loads(schema("sarif-schema-2.1.0.json").read_text())
    files = [str(one) for one in CAPTURES[kind] if one.exists()]
    assert files
    run(["check", *files, "-o", str(tmp_path / "x.sarif")])
    document = json.loads((tmp_path / "x.sarif").read_text())
    Draft4Validator(rules).validate(document)
    assert bool(document["runs"][0]["results"]) == (kind != "nothing wrong")


def valid_junit(path: Path) -> None:
    if shutil.which("xmllint") is None:
        pytest.skip("needs xmllint: apt-get install libxml2-utils")
    command = ["xmllint", "--noout", "--schema", str(schema("junit-10.xsd")), str(path)]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stderr


@pytest.mark.parametrize("kind", CAPTURES)
def test_junit_is_valid_by_the_schema_of_jenkins(kind: str, tmp_path: Path) -> None:
    run(["check", *map(str, CAPTURES[kind]), "-o", str(tmp_path / "x.xml")])
    valid_junit(tmp_path / "x.xml")


def test_junit_with_all_that_a_case_can_have_is_valid(tmp_path: Path) -> None:
    cases = [
        Case("unit 1", "read", time_ns=1_234_567_890_123),
        Case("unit 1", "read", failures=["a < b", "c"], time_ns=7),
        Case("unit 2", "write", error="no \x00 answer"),
    ]
    (tmp_path / "x.xml").write_text(junit_xml("suite", cases), encoding="utf-8")
    valid_junit(tmp_path / "x.xml")
