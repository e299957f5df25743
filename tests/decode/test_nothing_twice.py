"""Whatever comes on a serial line, each ADU stands in exactly one transaction."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from mbtool.core import Direction, WireEvent
from mbtool.decode.pairing import Pairing
from mbtool.decode.transactions import Ends
from mbtool.modbus.transaction import Transaction
from tests.decode.test_pairing import ANSWER, READ, asked, told

PAUSES_MS = st.sampled_from((5, 20, 100, 450, 500, 900, 1500, 6000))
ADUS = st.tuples(st.booleans(), st.integers(1, 2), PAUSES_MS)


@given(
    st.lists(ADUS, max_size=40),
    st.sampled_from((True, False, None)),
    st.booleans(),
)
def test_each_adu_stands_in_one_transaction(
    script: list[tuple[bool, int, int]], waits: bool | None, timed: bool
) -> None:
    pairing = Pairing(Ends("rs485", timed=timed), lambda _: waits)
    now_ms = 0
    done: list[Transaction | WireEvent] = []
    sent = []
    for is_request, unit, pause_ms in script:
        now_ms += pause_ms
        adu = asked(READ, now_ms, unit=unit) if is_request else told(ANSWER, now_ms, unit=unit)
        sent.append(adu)
        done += pairing.feed(adu)
    done += pairing.close()
    pairs = [one for one in done if isinstance(one, Transaction)]
    for direction, times in (
        (Direction.REQUEST, [one.request_ns for one in pairs]),
        (Direction.RESPONSE, [one.response_ns for one in pairs]),
    ):
        heard = [adu.end_ns for adu in sent if adu.direction is direction]
        assert Counter(time for time in times if time is not None) == Counter(heard)


def test_a_held_request_that_grows_old_is_told_once() -> None:
    pairing = Pairing(Ends("rs485"), lambda _: False)
    done: list[Transaction | WireEvent] = []
    for at_ms in (0, 1500, 3000, 4500):
        done += pairing.feed(asked(READ, at_ms))
        if at_ms:
            done += pairing.feed(told(ANSWER, at_ms + 450))
    done += pairing.feed(told(ANSWER, 5500))
    done += pairing.close()
    pairs = [one for one in done if isinstance(one, Transaction)]
    assert len(pairs) == 4
    assert len({one.request_ns for one in pairs}) == 4
