"""The rules of a device that states none."""

from __future__ import annotations

from mbtool.slave.device.connection_policy import SPARE_NS, ConnectionPolicy, Loss


def test_so_many_masters_are_let_in_and_no_more() -> None:
    rules = ConnectionPolicy(places=2)
    first, second = (rules.admit("a", 0).peer for _ in range(2))
    assert first is not None
    assert second is not None
    third = rules.admit("a", 1)
    assert (third.peer, third.leaves, third.is_full) == (None, None, True)
    rules.lost(first, Loss.CLOSED, 2)
    rules.lost(first, Loss.CLOSED, 3)
    assert rules.peers == [second]
    assert rules.admit("a", 4).peer is not None


def test_nothing_else_is_asked_for() -> None:
    rules = ConnectionPolicy()
    assert (rules.keep_alive, rules.closed_until_ns, rules.changed) == (None, None, False)
    assert rules.split_s == float("inf")


def test_a_master_that_never_asked_makes_room_after_a_second() -> None:
    policy = ConnectionPolicy(places=2)
    busy, silent = policy.admit("10.0.0.1", 0).peer, policy.admit("10.0.0.2", 0).peer
    assert busy is not None
    busy.heard_ns = 1
    assert policy.admit("10.0.0.3", SPARE_NS - 1).is_full
    admission = policy.admit("10.0.0.3", SPARE_NS)
    assert admission.leaves is silent
    assert policy.peers == [busy, admission.peer]
    assert policy.admit("10.0.0.4", SPARE_NS).is_full
