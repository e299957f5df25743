from __future__ import annotations

import re

from mbtool.devices.checking.rules import RULES, DeviceCode, Severity, rule_of, severity_of


def test_a_code_has_a_family_and_a_number_or_is_the_letter_of_devices() -> None:
    for code, rule in RULES.items():
        assert rule.code == code
        pattern = r"[A-Z]" if rule.is_of_devices else r"(MB|RTU|TCP|SEC)-\d{3}|(FA3|WAGO)-X\d{1,2}"
        assert re.fullmatch(pattern, code), code


def test_the_meaning_of_a_rule_is_one_sentence() -> None:
    for rule in RULES.values():
        assert re.fullmatch(r"[A-Z].*\.", rule.meaning)
        assert rule.source


def test_the_code_of_a_device_is_parsed() -> None:
    parsed = DeviceCode.parse("FT1A-Q16")
    assert parsed is not None
    assert (parsed.prefix, parsed.rule.code, parsed.number) == ("FT1A", "Q", 16)
    assert DeviceCode.parse("MY-PUMP-7-A3") is not None
    assert DeviceCode.parse("FA3-X1") is None
    assert DeviceCode.parse("MB-101") is None


def test_a_code_has_the_severity_of_its_rule() -> None:
    assert severity_of("FT1A-Q16") is Severity.ERROR
    assert severity_of("MB-404") is Severity.NOTE
    assert severity_of("FA3-X2") is Severity.WARNING


def test_an_unknown_code_is_a_warning_without_a_rule() -> None:
    assert rule_of("RTU-CRC") is None
    assert severity_of("RTU-CRC") is Severity.WARNING
