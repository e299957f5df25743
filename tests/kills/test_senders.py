"""The list by which logs of killed recordings are judged."""

from __future__ import annotations

import random
from itertools import islice

from tests.kills.__main__ import OLD_S, RATES, TERMINALS, _moments
from tests.kills.senders import TapSender, _write, number_of
from tests.soak.asked import rtu_adu, tcp_adu


def test_the_number_of_a_request_is_read_from_either_kind_of_frame() -> None:
    for number in (0, 1, 59_999, 60_000, 1 << 31):
        assert number_of(tcp_adu(number, _write(number))) == number
        assert number_of(rtu_adu(1, _write(number))) == number


def test_200_moments_have_all_rates_and_terminals_on_both_kinds_of_links() -> None:
    moments = list(islice(_moments(random.Random(1)), 200))
    assert {one.rate for one in moments} == set(RATES)
    assert {one.terminal for one in moments} == set(TERMINALS)
    assert {one.is_line for one in moments} == {False, True}
    assert min(one.after_s for one in moments) > OLD_S - 0.001


def test_a_sender_that_was_never_begun_ends() -> None:
    assert TapSender().stop() == []
