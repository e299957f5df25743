"""What a device does that its profile's data cannot say: functions of the maker's own."""

# A profile names its behaviour, and the responder asks here what the device's own functions answer.
# An own function gets the profile and the request, and gives the response, or None for silence.
#
# Sources, FA3: manual chapter 10.4, function code and data. Each request carries one byte, 00; what
# the module gives for another is not stated, and the code for a wrong request PDU is assumed.
# Remote reset (41H) answers nothing. That it also drops the connection and takes none for two
# seconds concerns the connection, which a responder does not see.

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from mbtool.core import ProfileError
from mbtool.modbus.pdu import exception_pdu

if TYPE_CHECKING:
    from mbtool.devices import Profile

OwnFunction = Callable[["Profile", bytes], bytes | None]

_FA3_DATA = b"\x00"


def own_functions(profile: Profile) -> Mapping[int, OwnFunction]:
    """The own functions of a device. Raises ProfileError for a behaviour that does not exist."""
    if profile.behaviour is None:
        return {}
    try:
        return BEHAVIOURS[profile.behaviour]
    except KeyError:
        known = ", ".join(sorted(BEHAVIOURS))
        raise ProfileError(
            profile.name, "behaviour", f"{profile.behaviour!r} does not exist; there is {known}"
        ) from None


def _fa3_remote_reset(profile: Profile, pdu: bytes) -> bytes | None:
    return None if pdu[1:] == _FA3_DATA else exception_pdu(pdu[0], profile.exceptions.value)


def _fa3_read_model_name(profile: Profile, pdu: bytes) -> bytes:
    if pdu[1:] != _FA3_DATA:
        return exception_pdu(pdu[0], profile.exceptions.value)
    return pdu[:1] + (profile.model_code or 0).to_bytes(2)


def _fa3_clear(profile: Profile, pdu: bytes) -> bytes:
    return pdu if pdu[1:] == _FA3_DATA else exception_pdu(pdu[0], profile.exceptions.value)


BEHAVIOURS: Mapping[str, Mapping[int, OwnFunction]] = {
    "fa3": {
        0x41: _fa3_remote_reset,
        0x42: _fa3_read_model_name,
        0x43: _fa3_clear,  # error clear
        0x44: _fa3_clear,  # error history clear
    }
}
