"""Finding a device's behaviour."""

from __future__ import annotations

import msgspec
import pytest

from mbtool.devices import load_profile
from mbtool.devices.model import BehaviourName
from mbtool.slave.device.behaviour import Behaviour
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families.behaviours import BEHAVIOURS, behaviour_of
from mbtool.slave.families.fa3 import Fa3, Fa3AnalogInput, Fa3AnalogOutput, Fa3DigitalOutput


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


def test_every_name_that_a_profile_can_give_has_its_behaviour() -> None:
    assert {name.partition("/")[0] for name in BEHAVIOURS} == {*BehaviourName}
    for name in BehaviourName:
        assert name in BEHAVIOURS, "of a model that has none of its own"
