"""Finding a device's behaviour."""

from __future__ import annotations

import msgspec
import pytest

from mbtool.core import ProfileError
from mbtool.devices import load_profile
from mbtool.slave.behaviour import Behaviour
from mbtool.slave.behaviours import behaviour_of
from mbtool.slave.fa3 import Fa3, Fa3DigitalOutput
from mbtool.slave.fa3_analog import Fa3AnalogInput, Fa3AnalogOutput
from mbtool.slave.image import RegisterImage


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("idec-ft1a-touch", Behaviour),
        ("fa3-th1m16xc", Fa3),
        ("fa3-th1m16y", Fa3DigitalOutput),
        ("fa3-th1m16ye", Fa3DigitalOutput),
        ("fa3-at1m8x", Fa3AnalogInput),
        ("fa3-at1m8y", Fa3AnalogOutput),
    ],
)
def test_a_device_gets_the_behaviour_of_its_model(name: str, kind: type[Behaviour]) -> None:
    assert type(behaviour_of(load_profile(name), RegisterImage())) is kind


def test_a_model_that_has_none_of_its_own_gets_its_familys() -> None:
    own = msgspec.structs.replace(load_profile("fa3-at1m8x"), model_code=0x7777)
    assert type(behaviour_of(own, RegisterImage())) is Fa3


def test_a_behaviour_that_does_not_exist_is_named() -> None:
    profile = msgspec.structs.replace(load_profile("fa3-at1m8x"), behaviour="fa4")
    with pytest.raises(ProfileError, match="fa3-at1m8x: behaviour: 'fa4' does not exist; there is"):
        behaviour_of(profile, RegisterImage())
