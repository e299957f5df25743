"""An FA3 module's connections, on a clock of the test's own."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from mbtool.devices import load_profile
from mbtool.modbus import Table
from mbtool.slave.device.connection_policy import MAX_NOTES, KeepAlive, Loss, Peer
from mbtool.slave.device.image import RegisterImage
from mbtool.slave.families.fa3 import DISCONNECTING_NS, RESETTING_NS, Fa3Connections

PROFILE = load_profile("fa3-th1m16xc")
SECOND = 1_000_000_000


class _Module:
    """What the rules tell the module they belong to."""

    def __init__(self) -> None:
        self.image = RegisterImage.of(PROFILE)
        self.alarms: list[int] = []
        self.linked: list[bool] = []
        self.rules = Fa3Connections(
            PROFILE, self.image, alarm=self.alarms.append, linked=self.linked.append
        )

    def admit(self, now_ns: int, host: str = "10.0.0.1") -> Peer:
        peer = self.rules.admit(host, now_ns).peer
        assert peer is not None
        return peer

    def set_timers(self, address: int, *values: int) -> None:
        self.image.set(Table.HOLDING_REGISTERS, address, values)


def test_a_third_connection_takes_the_place_of_the_one_that_was_silent_longest() -> None:
    module = _Module()
    first, second = module.admit(1), module.admit(2)
    first.heard_ns = 3
    third = module.rules.admit("10.0.0.2", 4)
    assert third.leaves is second
    assert third.peer is not None
    fourth = module.rules.admit("10.0.0.2", 5)
    assert fourth.leaves is first
    assert module.rules.peers == [third.peer, fourth.peer]
    assert (module.alarms, module.linked) == ([], [True])


class Connections(RuleBasedStateMachine):
    """Masters come, speak and go, against a list kept by hand."""

    def __init__(self) -> None:
        super().__init__()
        self.module = _Module()
        self.here: list[tuple[int, Peer]] = []
        self.now_ns = 0

    @rule(host=st.sampled_from(["10.0.0.1", "10.0.0.2"]))
    def connect(self, host: str) -> None:
        self.now_ns += 1
        leaves = min(self.here, key=lambda one: one[0])[1] if len(self.here) == 2 else None
        admission = self.module.rules.admit(host, self.now_ns)
        if admission.peer is None:  # It was found dead a while ago.
            assert admission.leaves is None
            return
        assert admission.leaves is leaves
        self.here = [one for one in self.here if one[1] is not leaves]
        self.here.append((self.now_ns, admission.peer))

    @precondition(lambda self: self.here)
    @rule(data=st.data())
    def speak(self, data: st.DataObject) -> None:
        self.now_ns += 1
        at = data.draw(st.integers(0, len(self.here) - 1))
        _, peer = self.here.pop(at)
        peer.heard_ns = self.now_ns
        self.here.insert(at, (self.now_ns, peer))

    @precondition(lambda self: self.here)
    @rule(data=st.data(), loss=st.sampled_from(Loss))
    def lose(self, data: st.DataObject, loss: Loss) -> None:
        self.now_ns += 1
        _, peer = self.here.pop(data.draw(st.integers(0, len(self.here) - 1)))
        before = len(self.module.alarms)
        self.module.rules.lost(peer, loss, self.now_ns)
        self.module.rules.lost(peer, loss, self.now_ns)
        assert len(self.module.alarms) - before == (loss is not Loss.CLOSED)

    @rule()
    def wait(self) -> None:
        self.now_ns += DISCONNECTING_NS

    @invariant()
    def at_most_two_are_there_and_the_outputs_know(self) -> None:
        assert self.module.rules.peers == [peer for _, peer in self.here]
        assert len(self.here) <= 2
        linked = self.module.linked
        assert linked == [at % 2 == 0 for at in range(len(linked))]
        assert (linked[-1] if linked else False) is bool(self.here)


TestConnections = Connections.TestCase


def test_who_had_to_leave_is_not_lost_a_second_time() -> None:
    module = _Module()
    first = module.admit(1)
    module.admit(2)
    module.admit(3)
    module.rules.lost(first, Loss.NOT_ALIVE, 4)
    assert len(module.rules.peers) == 2
    assert module.alarms == []


def test_it_is_linked_from_the_first_connection_to_the_last() -> None:
    module = _Module()
    first, second = module.admit(1), module.admit(2)
    module.rules.lost(first, Loss.CLOSED, 3)
    assert module.linked == [True]
    module.rules.lost(second, Loss.CLOSED, 4)
    module.admit(5)
    assert module.linked == [True, False, True]


def test_a_master_that_is_not_alive_is_alarm_0e30_and_one_that_splits_0e40() -> None:
    module = _Module()
    first, second = module.admit(1), module.admit(2, "10.0.0.2")
    module.rules.lost(first, Loss.NOT_ALIVE, 3)
    module.rules.lost(second, Loss.SPLIT, 4)
    assert module.alarms == [0x0E30, 0x0E40]


def test_while_it_disconnects_a_master_that_master_is_rejected() -> None:
    module = _Module()
    module.rules.lost(module.admit(0), Loss.NOT_ALIVE, SECOND)
    end = SECOND + DISCONNECTING_NS
    rejected = module.rules.admit("10.0.0.1", end - 1)
    assert (rejected.peer, rejected.is_full) == (None, False)
    assert list(module.rules.notes) == [
        "alive check error (0E30H): the connection from 10.0.0.1 is closed, and 10.0.0.1 is "
        "rejected for 10 s"
    ]
    assert module.rules.admit("10.0.0.2", end - 1).peer is not None
    assert module.rules.admit("10.0.0.1", end).peer is not None


def test_a_connection_that_a_master_closes_can_be_made_again_at_once() -> None:
    module = _Module()
    module.rules.lost(module.admit(0), Loss.CLOSED, 1)
    assert module.rules.admit("10.0.0.1", 1).peer is not None


def test_what_it_remembers_of_masters_is_forgotten_after_ten_seconds() -> None:
    module = _Module()
    for number in range(100):
        now_ns = number * SECOND
        module.rules.lost(module.admit(now_ns, f"10.0.0.{number}"), Loss.NOT_ALIVE, now_ns)
    assert len(module.rules._rejected) <= DISCONNECTING_NS // SECOND


def test_the_alive_check_is_630_seconds_by_default() -> None:
    setting = _Module().rules.keep_alive
    assert setting == KeepAlive(start_s=600, interval_s=10, count=3)
    assert setting.start_s + setting.count * setting.interval_s == 630


@pytest.mark.parametrize(
    ("values", "setting"),
    [
        ((1, 1, 1), (1, 1, 1)),
        ((0, 0, 0), (1, 1, 1)),
        ((14400, 60, 100), (14400, 60, 100)),
        ((14401, 61, 101), (14400, 60, 100)),
        ((0xFFFF, 0xFFFF, 0xFFFF), (14400, 60, 100)),
    ],
)
def test_a_timer_outside_its_range_counts_as_the_nearest_limit_and_stays_as_written(
    values: tuple[int, ...], setting: tuple[int, int, int]
) -> None:
    module = _Module()
    module.set_timers(0x00F2, *values)
    assert module.rules.keep_alive == KeepAlive(*setting)
    assert module.image.get(Table.HOLDING_REGISTERS, 0x00F2, 3) == list(values)


@pytest.mark.parametrize(("value", "seconds"), [(0, 1), (1, 1), (30, 30), (1201, 1200)])
def test_split_reception_is_from_1_to_1200_seconds(value: int, seconds: int) -> None:
    module = _Module()
    assert module.rules.split_s == 30
    module.set_timers(0x00F5, value)
    assert module.rules.split_s == seconds


def test_what_it_does_is_told_in_a_bounded_number_of_sentences() -> None:
    module = _Module()
    first, second = module.admit(0), module.admit(SECOND)
    module.admit(3 * SECOND, "10.0.0.2")
    module.rules.lost(second, Loss.SPLIT, 4 * SECOND)
    module.rules.reset(5 * SECOND)
    assert list(module.rules.notes) == [
        "a third connection, from 10.0.0.2: the one from 10.0.0.1 is closed, which was silent for "
        "3.0 s",
        "split reception monitoring error (0E40H): the connection from 10.0.0.1 is closed",
        "remote reset: all connections are closed, and none is taken for 2 s",
    ]
    assert first not in module.rules.peers
    for _ in range(2 * MAX_NOTES):
        module.rules.reset(5 * SECOND)
    assert len(module.rules.notes) == MAX_NOTES


def test_a_profile_without_limits_for_a_timer_lets_it_be() -> None:
    profile = msgspec.structs.replace(PROFILE, points=[])
    image = RegisterImage()
    image.set(Table.HOLDING_REGISTERS, 0x00F5, [5000])
    rules = Fa3Connections(profile, image, alarm=lambda _: None, linked=lambda _: None)
    assert rules.split_s == 5000


def test_a_reset_takes_no_connection_for_two_seconds() -> None:
    module = _Module()
    module.admit(0)
    before = module.rules.closed_until_ns
    module.rules.reset(SECOND)
    assert (before, module.rules.changed) == (None, True)
    assert module.rules.closed_until_ns == SECOND + RESETTING_NS
    assert module.rules.admit("10.0.0.9", SECOND + RESETTING_NS - 1).peer is None
    assert module.rules.admit("10.0.0.9", SECOND + RESETTING_NS).peer is not None
