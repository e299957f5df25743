"""Makes a device with the behaviour that its profile names."""

# To add a family: put a name for it into BehaviourName (devices/model.py), and a class into
# BEHAVIOURS under this name. If one model of the family differs from the others, its class has the
# key "NAME/MODEL CODE", with the code as four hex digits.

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from mbtool.slave.device.behaviour import Behaviour
from mbtool.slave.device.responder import DeviceResponder
from mbtool.slave.families.fa3 import Fa3, Fa3AnalogInput, Fa3AnalogOutput, Fa3DigitalOutput
from mbtool.slave.families.lt830 import Lt830
from mbtool.slave.families.wago import Wago

if TYPE_CHECKING:
    from mbtool.devices import Profile
    from mbtool.slave.device.image import RegisterImage

BEHAVIOURS: Mapping[str, Callable[[Profile, RegisterImage], Behaviour]] = {
    "fa3": Fa3,
    "fa3/0014": Fa3DigitalOutput,  # FA3-TH1M16Y
    "fa3/0015": Fa3DigitalOutput,  # FA3-TH1M16YE
    "fa3/0016": Fa3AnalogInput,  # FA3-AT1M8X
    "fa3/0017": Fa3AnalogOutput,  # FA3-AT1M8Y
    "lt830": Lt830,
    "wago": Wago,
}
"""By the `behaviour` that a profile names, the class that makes it; "NAME/MODEL CODE" for one model
of a family ("fa3/0014")."""


def make_device(profile: Profile, image: RegisterImage) -> DeviceResponder:
    """Return a device that answers from its image, with the behaviour that its profile names."""
    return DeviceResponder(behaviour_of(profile, image))


def behaviour_of(profile: Profile, image: RegisterImage) -> Behaviour:
    if profile.behaviour is None:
        return Behaviour(profile, image)
    model = f"{profile.behaviour}/{profile.model_code or 0:04X}"
    make = BEHAVIOURS.get(model) or BEHAVIOURS[profile.behaviour]
    return make(profile, image)
