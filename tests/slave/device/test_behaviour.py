"""What a behaviour may change, seen through the responder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices import Access, Area, FunctionRule, Profile, load_profile
from mbtool.devices.block_reads import can_be_read
from mbtool.modbus import Table, Transport
from mbtool.slave.device.behaviour import MAX_ALLOWED, Behaviour
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.device.responder import DeviceResponder
from mbtool.slave.families import make_device

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mbtool.modbus import RegisterAccess

HOLDING = Table.HOLDING_REGISTERS


def _profile(*areas: tuple[int, int, Access]) -> Profile:
    return Profile(
        name="own",
        title="Own",
        vendor="Own",
        transports=[Transport.TCP],
        source="none",
        areas=[
            Area(name=f"area {access}", table=HOLDING, first=first, last=last, access=access)
            for first, last, access in areas
        ],
        functions={code: FunctionRule() for code in ("03", "06", "10", "16")},
    )


def _ask(device: DeviceResponder, request: str, now_ns: int = 0) -> str:
    answer = device.respond(1, bytes.fromhex(request), now_ns)
    assert answer is not None
    return answer.pdu.hex(" ")


def test_without_behaviour_of_its_own_a_device_keeps_and_puts_out_nothing() -> None:
    plain = Behaviour(_profile((0, 9, Access.READ_WRITE)), RegisterImage())
    assert (plain.kept, plain.rules, plain.outputs(), dict(plain.own)) == ((), None, (), {})


def test_what_is_written_where_something_else_is_read_does_not_show_there() -> None:
    profile = _profile((0, 9, Access.READ), (0, 4, Access.WRITE), (20, 29, Access.READ_WRITE))
    device = make_device(profile, RegisterImage())
    device.image.set(HOLDING, 0, [1, 2, 3])
    assert _ask(device, "06 0000 AAAA") == "06 00 00 aa aa"
    assert _ask(device, "10 0001 0002 04 AAAA BBBB") == "10 00 01 00 02"
    assert _ask(device, "03 0000 0003") == "03 06 00 01 00 02 00 03"
    assert _ask(device, "06 0014 AAAA") == "06 00 14 aa aa"
    assert _ask(device, "03 0014 0001") == "03 02 aa aa"
    assert _ask(device, "06 0005 AAAA") == "86 02"


class _Moody(Behaviour):
    """Refuses writes of address 1, and shows the time at address 2."""

    def refusal(
        self, function: int, reach: RegisterAccess, values: Sequence[int], now_ns: int
    ) -> int | None:
        return 4 if 1 in reach.writes else None

    def is_live(self, table: Table, span: range) -> bool:
        return 2 in span

    def shown(self, table: Table, span: range, values: list[int], now_ns: int) -> list[int]:
        return [
            now_ns if address == 2 else value for address, value in zip(span, values, strict=True)
        ]


def test_a_behaviour_refuses_after_all_other_checks_and_shows_what_it_likes() -> None:
    profile = _profile((0, 9, Access.READ_WRITE))
    device = DeviceResponder(_Moody(profile, RegisterImage()))
    assert _ask(device, "06 0001 0007") == "86 04"
    assert device.image.get(HOLDING, 1) == [0]
    assert _ask(device, "10 0001 000A 14" + 10 * "0000") == "90 02"
    for now_ns in (5, 6):
        assert _ask(device, "03 0001 0002", now_ns) == f"03 04 00 00 00 {now_ns:02x}"


class _Apart(Behaviour):
    """Writes go to a place 16 addresses higher."""

    def present_values(self, table: Table, span: range) -> list[int]:
        return self.image.get(table, span.start + 16, len(span))

    def store(self, table: Table, span: range, values: Sequence[int]) -> None:
        self.image.set(table, span.start + 16, values)


def test_a_behaviour_says_where_writes_go_and_what_a_mask_leaves() -> None:
    profile = _profile((0, 31, Access.READ_WRITE))
    device = DeviceResponder(_Apart(profile, RegisterImage()))
    assert _ask(device, "06 0001 1234") == "06 00 01 12 34"
    assert _ask(device, "16 0001 FF00 0055") == "16 00 01 ff 00 00 55"
    assert device.image.get(HOLDING, 1) == [0]
    assert device.image.get(HOLDING, 17) == [0x1255]


class _Watchful(Behaviour):
    """Refuses everything from moment 10 on, and keeps what requests came to."""

    watches = True

    def __init__(self, profile: Profile, image: RegisterImage) -> None:
        super().__init__(profile, image)
        self.came_to: list[str] = []

    def barred(self, pdu: bytes, now_ns: int) -> int | None:
        return 4 if now_ns >= 10 else None

    def answered(self, pdu: bytes, response: bytes | None, now_ns: int) -> None:
        self.came_to.append(response.hex() if response is not None else "")


def test_a_behaviour_that_watches_learns_of_each_request_also_of_one_that_comes_again() -> None:
    profile = _profile((0, 9, Access.READ_WRITE))
    device = DeviceResponder(_Watchful(profile, RegisterImage()))
    for now_ns in (1, 2, 3):
        assert _ask(device, "03 0000 0001", now_ns) == "03 02 00 00"
    assert _ask(device, "03 0009 0002", 4) == "83 02"
    for request in ("03 0000 0001", "03 0009 0002", "2B"):
        code = int(request[:2], 16) | 0x80
        assert _ask(device, request, 10) == f"{code:02x} 04"
    behaviour = device.behaviour
    assert isinstance(behaviour, _Watchful)
    assert behaviour.came_to == [*["03020000"] * 3, "8302", "8304", "8304", "ab04"]


def test_what_may_be_read_is_what_findings_allow_and_is_remembered_in_bounds() -> None:
    profile = load_profile("wago-750")
    behaviour = Behaviour(profile, RegisterImage.of(profile))
    for first in range(MAX_ALLOWED + 10):
        span = range(0x1000 + first, 0x1000 + first + 9)
        for _ in range(2):
            assert behaviour.allows(Table.HOLDING_REGISTERS, span) is can_be_read(
                profile, Table.HOLDING_REGISTERS, span
            )
    assert len(behaviour._allowed) <= MAX_ALLOWED
