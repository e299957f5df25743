"""A slave without a link, whose answers and pauses no busy machine can change."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

from mbtool.master.wire import Heard, HeardAdu, Wire
from mbtool.modbus import rtu_adu
from mbtool.modbus.adu import crc
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mbtool.devices import Profile


class SlaveInMemory(Wire):
    """A wire with a slave that answers at once.

    It answers a request (its PDU) if `answers` says so. It takes bytes apart at each silence longer
    than `silence_ns`, and drops what is no whole frame; after such a piece it ignores `deaf`
    requests. Each pause is as long as the test says, with `made_ns` it is made that long instead.
    """

    def __init__(
        self,
        profile: Profile,
        unit: int,
        *,
        answers: Callable[[bytes], bool] = lambda pdu: True,
        silence_ns: float = inf,
        deaf: int = 0,
        made_ns: int = 0,
    ) -> None:
        super().__init__(timeout_ns=1)
        self._device = make_device(profile, RegisterImage())
        self._unit, self._answers = unit, answers
        self._silence_ns, self._made_ns = silence_ns, made_ns
        self._deaf, self._ignored = deaf, 0

    def adu(self, unit: int, pdu: bytes) -> bytes:
        return rtu_adu(unit, pdu)

    def send(self, pieces: Sequence[bytes], pause_ns: int = 0, awaited: int = 1) -> Heard:
        pause_ns = self._made_ns or pause_ns
        frames = pieces if pause_ns > self._silence_ns else [b"".join(pieces)]
        response = b"".join(self._answer(frame) for frame in frames)
        adus = (HeardAdu(response[0], response[1:-2]),) if response else ()
        return Heard(response, adus, 1, made_pause_ns=pause_ns if len(pieces) > 1 else 0)

    def _answer(self, frame: bytes) -> bytes:
        if crc(frame):
            self._ignored = self._deaf
            return b""
        if self._ignored:
            self._ignored -= 1
            return b""
        if frame[0] != self._unit or not self._answers(frame[1:-2]):
            return b""
        response = self._device.respond(self._unit, frame[1:-2], 0)
        return b"" if response is None else rtu_adu(self._unit, response.pdu)

    def hear(self, wait_ns: int, since_ns: int | None = None) -> Heard:
        return Heard(b"", (), 0)

    def damage(self, raw: bytes, request: bytes) -> str:
        return raw.hex()

    def close(self) -> None:
        pass
