"""The own functions of devices."""

from __future__ import annotations

import msgspec
import pytest

from mbtool.core import ProfileError
from mbtool.devices import load_profile
from mbtool.slave.behaviours import own_functions

# FA3 chapter 10.4, read model name.
MODEL_CODES = {
    "fa3-th1m16xc": "0013",
    "fa3-th1m16y": "0014",
    "fa3-th1m16ye": "0015",
    "fa3-at1m8x": "0016",
    "fa3-at1m8y": "0017",
}


def _answer(request: str, name: str = "fa3-at1m8x") -> str | None:
    profile, pdu = load_profile(name), bytes.fromhex(request)
    answer = own_functions(profile)[pdu[0]](profile, pdu)
    return None if answer is None else answer.hex(" ")


@pytest.mark.parametrize(("name", "code"), MODEL_CODES.items())
def test_fa3_tells_its_model_code(name: str, code: str) -> None:
    assert _answer("42 00", name) == f"42 {code[:2]} {code[2:]}"


def test_fa3_echoes_the_clearing_of_errors() -> None:
    assert _answer("43 00") == "43 00"
    assert _answer("44 00") == "44 00"


def test_fa3_answers_a_remote_reset_with_silence() -> None:
    assert _answer("41 00") is None


@pytest.mark.parametrize("function", ["41", "42", "43", "44"])
@pytest.mark.parametrize("data", ["", "01", "00 00"])
def test_fa3_refuses_other_data_than_00(function: str, data: str) -> None:
    assert _answer(f"{function} {data}") == f"{int(function, 16) | 0x80:02x} 03"


def test_a_device_without_behaviour_has_no_own_functions() -> None:
    assert own_functions(load_profile("idec-ft1a-touch")) == {}


def test_a_behaviour_that_does_not_exist_is_named() -> None:
    profile = msgspec.structs.replace(load_profile("fa3-at1m8x"), behaviour="fa4")
    with pytest.raises(ProfileError, match="fa3-at1m8x: behaviour: 'fa4' does not exist"):
        own_functions(profile)
