"""A simulated device with values that change over time."""

# The values are computed when a request arrives, so nothing runs between two requests. Time counts
# from the first request. If a master writes to an address with a changing value, the written value
# stays until a request comes at least RESOLUTION_NS after the last computation.
#
# A device that averages its inputs (Behaviour.inputs_set) needs their values between two requests
# too. So they are also computed for moments between the previous request and this one, fewer than
# MAX_BETWEEN.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mbtool.slave.device.behaviour import Behaviour

if TYPE_CHECKING:
    from mbtool.modbus.response import Response
    from mbtool.slave.device.image_file import Driven
    from mbtool.slave.device.responder import DeviceResponder

RESOLUTION_NS = 1_000_000
MAX_BETWEEN = 64


class DrivenDevice:
    """A responder that sets the changing values of a device, then lets it answer the request."""

    def __init__(self, device: DeviceResponder, driven: Sequence[Driven]) -> None:
        self._device = device
        self._driven = driven
        self._averages = type(device.behaviour).inputs_set is not Behaviour.inputs_set
        self._begin_ns: int | None = None
        self._last_ns = 0

    def respond(self, unit: int, pdu: bytes, now_ns: int) -> Response | None:
        if self._begin_ns is None:
            self._begin_ns = now_ns
            self._move(now_ns)
        elif now_ns - self._last_ns >= RESOLUTION_NS:
            for moment_ns in self._moments_until(now_ns) if self._averages else ():
                self._move(moment_ns)
            self._move(now_ns)
        return self._device.respond(unit, pdu, now_ns)

    def _moments_until(self, now_ns: int) -> Sequence[int]:
        """Return moments in ns between the last computation and `now_ns`, at equal distances.

        They are at least RESOLUTION_NS apart. There are fewer than MAX_BETWEEN, and none if less
        than two RESOLUTION_NS have passed.
        """
        passed_ns = now_ns - self._last_ns
        count = min(passed_ns // RESOLUTION_NS, MAX_BETWEEN)
        return [self._last_ns + passed_ns * place // count for place in range(1, count)]

    def _move(self, now_ns: int) -> None:
        self._last_ns = now_ns
        moment_ns = now_ns - (self._begin_ns or 0)
        for each in self._driven:
            each.target.put(self._device.image, each.course(moment_ns))
        self._device.behaviour.inputs_set(now_ns)
