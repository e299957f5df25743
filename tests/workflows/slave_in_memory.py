"""Slaves without a link, whose answers and pauses no busy machine can change."""

from __future__ import annotations

from collections import deque
from math import inf
from typing import TYPE_CHECKING

from mbtool.core import Direction, SerialLink, TcpLink
from mbtool.core.moments import SECOND_NS
from mbtool.framing import MbapSplitter, RtuStreamSplitter
from mbtool.master.wire import Heard, HeardAdu, Wire
from mbtool.modbus import Adu, Response, rtu_adu
from mbtool.modbus.adu import crc
from mbtool.modbus.response import ConnectionEnding, wire_pieces
from mbtool.serial_line import AsciiSplitter, RtuSplitter
from mbtool.slave.device import RegisterImage
from mbtool.slave.families import make_device
from mbtool.workflows.slave import device_slave

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    import pytest

    from mbtool.core import LinkSpec
    from mbtool.devices import Profile
    from mbtool.modbus import Responder, Skipped


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


class TimelessSlave:
    """The slave of `mbtool slave` for masters in this process, and the only clock that they have.

    It stands in place of the modules `time` and `select`, of the serial port and of the connection
    where a master uses them: the time passes only while the master waits, and all that it does with
    the bytes is its own.
    """

    def __init__(
        self, patch: pytest.MonkeyPatch, profile: Profile, link: LinkSpec, unit: int,
        faults: Path | None,
    ) -> None:  # fmt: skip
        self.now_ns, self.link = SECOND_NS, link

        def keep(responder: Responder) -> Responder:
            self.responder = responder
            return responder

        device_slave(profile, link, unit, fault_file=faults, wrapped=keep)
        for module in ("master.links", "master.wire", "workflows.conformance"):
            patch.setattr(f"mbtool.{module}.time", self)
        for module in ("master.links", "master.wire"):
            patch.setattr(f"mbtool.{module}.select", self)
        patch.setattr("mbtool.master.links.open_port", lambda *_: _End(self))
        patch.setattr("mbtool.master.wire.socket.create_connection", lambda *_: _End(self))

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND_NS)

    def select(
        self, ends: list[_End], _writing: object, _failed: object, seconds: float
    ) -> tuple[list[_End], tuple[()], tuple[()]]:
        return [end for end in ends if end.wait(round(seconds * SECOND_NS))], (), ()


class _End:
    """The master's end of the link: a serial port or a socket."""

    def __init__(self, slave: TimelessSlave) -> None:
        self._slave = slave
        self._splitter: RtuSplitter | AsciiSplitter | RtuStreamSplitter | MbapSplitter
        self._character_ns = self._silence_ns = self._timeout_ns = 0
        if isinstance(slave.link, SerialLink):
            line = slave.link.format
            self._character_ns, self._silence_ns = line.character_ns, line.t3_5_ns
            splitter = AsciiSplitter if slave.link.ascii else RtuSplitter
            self._splitter = splitter(line, speaker=Direction.REQUEST)
        else:
            assert isinstance(slave.link, TcpLink)
            self._splitter = (RtuStreamSplitter if slave.link.rtu else MbapSplitter)(
                Direction.REQUEST
            )
        self._due: deque[tuple[int, bytes | ConnectionEnding]] = deque()
        """What the slave sends and how it ends the connection, each with its time in ns."""

    def sendall(self, data: bytes) -> None:
        self.wait(0)
        self._slave.now_ns += len(data) * self._character_ns
        self._take(self._splitter.feed(data, self._slave.now_ns))

    write = sendall

    def wait(self, wait_ns: int) -> bool:
        """Let the time pass until something can be read, for at most `wait_ns` ns."""
        slave, until_ns = self._slave, self._slave.now_ns + wait_ns
        if not isinstance(self._splitter, RtuStreamSplitter | MbapSplitter):
            for now_ns in (min(until_ns, slave.now_ns + self._silence_ns), until_ns):
                if not self._due:
                    self._take(self._splitter.advance(now_ns))
        if not self._due or self._due[0][0] > until_ns:
            slave.now_ns = until_ns
            return False
        slave.now_ns = max(slave.now_ns, self._due[0][0])
        return True

    def _take(self, events: Sequence[Adu | Skipped]) -> None:
        for one in events:
            if not isinstance(one, Adu):
                continue
            response = self._slave.responder.respond(one.unit, one.pdu, one.end_ns)
            if response is not None:
                self._send(one, response)

    def _send(self, request: Adu, response: Response) -> None:
        at_ns = request.end_ns + max(response.delay_ns, self._silence_ns)
        pieces = wire_pieces(response, request.transport, request.unit, request.transaction_id or 0)
        self._due.extend((at_ns + later_ns, data) for later_ns, data in pieces)
        if response.distortion is not None and response.distortion.ending is not None:
            self._due.append((at_ns, response.distortion.ending))

    def recv(self, _size: int) -> bytes:
        if not self.wait(self._timeout_ns):
            raise TimeoutError
        _, data = self._due.popleft()
        if data is ConnectionEnding.RESET:
            raise ConnectionResetError
        return b"" if isinstance(data, ConnectionEnding) else data

    read = recv
    in_waiting = 1
    """A read of the port brings what was sent at one time, however many bytes are asked for."""

    def settimeout(self, seconds: float) -> None:
        self._timeout_ns = round(seconds * SECOND_NS)

    def close(self, *_: object) -> None:
        """Do nothing: the slave does not notice that its master has left."""

    flush = setsockopt = close
