"""Hints at the model of a slave."""

from __future__ import annotations

from typing import Any

import pytest

from mbtool.devices import Assignments, Namer, Profile, parse_assignment
from mbtool.modbus import mbap_adu, rtu_adu
from mbtool.modbus.adu import Transport
from mbtool.workflows.shared.model_hints import MAX_HINTS, ModelHints
from tests.devices.sunspec import registers
from tests.devices.transactions import transaction

SAID = "unit 0 at 192.168.3.250:502 is FA3-AT1M8X analog input module, 8 channels, "


def hints(*device: str, code: bytes = b"\x00\x16", times: int = 1, **fields: Any) -> list[str]:
    assignments = Assignments([parse_assignment(one) for one in device])
    found = ModelHints(assignments.profile_for)
    namer = Namer(assignments)
    defaults: dict[str, Any] = {
        "destination": "192.168.3.250:502",
        "transport": Transport.TCP,
        "unit": 0,
        "response_raw": mbap_adu(0, 0, b"\x42" + code),
    }
    for _ in range(times):
        found.note(namer.name(transaction(0x42, **{**defaults, **fields})))
    return found.remarks


def test_a_slave_that_nobody_named_is_hinted_at_once() -> None:
    assert hints(times=3) == [
        f"{SAID}as its answer to 42H says; name it with --device 192.168.3.250/0=fa3-at1m8x"
    ]


def test_one_that_is_named_as_another_model_is_a_remark() -> None:
    assert hints("all=fa3-at1m8y") == [
        f"{SAID}as its answer to 42H says, but it is named as fa3-at1m8y: "
        "give --device 192.168.3.250/0=fa3-at1m8x"
    ]


def test_one_that_is_named_rightly_or_as_another_device_is_left_alone() -> None:
    assert hints("all=fa3-at1m8x") == []
    assert hints("all=wago-750") == []


def test_what_is_no_model_code_is_none() -> None:
    assert hints(code=b"\x12\x34") == []
    assert hints(code=b"\x00\x16\x00") == []
    assert hints(exception=1) == []


def test_a_device_on_a_serial_line_is_no_module_of_a_network() -> None:
    raw = rtu_adu(1, b"\x42\x00\x16")
    assert hints(destination=None, transport=Transport.RTU, response_raw=raw) == []


def _sunspec(*device: str, blocks: int = 5) -> list[str]:
    assignments = Assignments([parse_assignment(one) for one in device])
    found = ModelHints(assignments.profile_for)
    told = []
    for address, values in [*registers().items()][:blocks]:
        one = transaction(3, address, quantity=len(values), response_values=values, unit=126)
        told.append(found.note(Namer(assignments).name(one)))
    return [*filter(None, told), *found.remarks]


def test_the_models_of_a_sunspec_device_are_told_when_their_end_was_read() -> None:
    hint = (
        "unit 126 at line is Maker Meter 7, SunSpec models 1, 64900, 64999 from 40000 on; "
        "mbtool devices draft with --sunspec makes its profile"
    )
    assert _sunspec() == [hint, hint]


@pytest.mark.parametrize("blocks", [2, 5])
def test_a_sunspec_device_with_a_profile_is_left_alone(blocks: int) -> None:
    assert _sunspec("126=wago-750", blocks=blocks) == []


def test_the_models_that_were_read_of_a_map_are_told_at_the_end() -> None:
    (hint,) = _sunspec(blocks=2)
    assert "Maker Meter 7, SunSpec models 1 from 40000 on" in hint


def test_hints_are_bounded() -> None:
    found = ModelHints(lambda _: None)
    raw = mbap_adu(0, 0, b"\x42\x00\x16")
    for unit in range(MAX_HINTS + 5):
        one = transaction(0x42, transport=Transport.TCP, unit=unit, response_raw=raw)
        found.note(Namer().name(one))
    assert len(found.remarks) == MAX_HINTS


def test_other_functions_load_no_profile() -> None:
    def never(_: object) -> Profile | None:
        raise AssertionError

    found = ModelHints(never)
    found.note(Namer().name(transaction(3, 0, quantity=1, response_values=[0x16])))
    assert found.remarks == []
