"""The candidates at the offsets of a window."""

from __future__ import annotations

from mbtool.core import Direction
from mbtool.modbus.adu import DirectionBy, rtu_adu
from mbtool.serial_line import costs
from mbtool.serial_line.bus_model import ROLES, BusModel, Classification
from mbtool.serial_line.candidates import ByteWindow, Candidates
from mbtool.serial_line.line_statistics import LearnedCost, LineStatistics
from mbtool.serial_line.paths import Segment, SegmentKind

REQUEST, RESPONSE = Direction.REQUEST, Direction.RESPONSE
CHARACTER = 573_000
SILENCE_NS = 2_005_000
READ = rtu_adu(1, bytes.fromhex("03 0000 0002"))
ANSWER = rtu_adu(1, bytes.fromhex("03 04 0001 0002"))


def candidates(
    data: bytes,
    *heard: bytes,
    silent_at: tuple[int, ...] = (),
    glue: float = costs.GLUED,
    may_continue: bool = True,
) -> tuple[Candidates, BusModel]:
    """The candidates of a window between two silences, after these requests were heard."""
    bus_model = BusModel()
    for raw in heard:
        bus_model.hear(Classification(REQUEST, DirectionBy.FORM, 1.0), raw[0], raw[1:-2], 0, 1)
    statistics = LineStatistics()
    statistics.glue = LearnedCost(glue, costs.GLUED_LIMITS)
    times, now_ns = [], 0
    for place in range(len(data)):
        now_ns += CHARACTER + (SILENCE_NS + place if place in silent_at else 0)
        times.append(now_ns)
    silences = [place in (0, len(data), *silent_at) for place in range(len(data) + 1)]
    window = ByteWindow(
        data, times, CHARACTER, silences, is_behind_noise=False, may_continue=may_continue
    )
    return Candidates(window, bus_model, statistics, ROLES), bus_model


def flipped(raw: bytes, at: int, bit: int = 0) -> bytes:
    return raw[:at] + bytes([raw[at] ^ 1 << bit]) + raw[at + 1 :]


def repaired(data: bytes) -> list[tuple[bytes, Direction]]:
    found, bus_model = candidates(data, READ)
    return [(one.repaired, one.role) for one in found.damaged(0, bus_model.state) if one.repaired]


def test_frames_are_found_in_each_form_that_they_have() -> None:
    found, _ = candidates(READ + ANSWER)
    (request,), (response,) = found.frames(0), found.frames(8)
    assert request.segment == Segment(SegmentKind.FRAME, 0, 8, REQUEST, (REQUEST,))
    assert response.segment == Segment(SegmentKind.FRAME, 8, 9, RESPONSE, (RESPONSE,))
    assert found.frames(1) == []


def test_one_wrong_bit_is_repaired_wherever_it_is() -> None:
    for at in range(len(ANSWER)):
        for bit in range(8):
            assert (ANSWER, RESPONSE) in repaired(flipped(ANSWER, at, bit) + READ)


def test_function_that_was_never_requested_is_not_repaired() -> None:
    found, bus_model = candidates(flipped(ANSWER, 1, 6) + READ)
    assert [one for one in found.damaged(0, bus_model.state) if one.repaired] == []


def test_wrong_bit_in_the_byte_count_is_repaired_if_no_byte_is_lost() -> None:
    damaged = flipped(ANSWER, 2, 1)  # Six bytes of registers instead of four.
    assert (ANSWER, RESPONSE) in repaired(damaged)
    assert repaired(damaged[:-1]) == []


def test_damaged_known_request_is_found_over_a_shorter_response() -> None:
    raw = next(
        raw
        for quantity in range(1, 256)
        if (raw := rtu_adu(1, bytes((1, 2, 7, 0, quantity))))[-1] == 0
    )
    damaged = raw[:-1] + b"\x04"
    sizes = [one.size for one in candidates(damaged, raw)[0].damaged_request(0)]
    assert sizes == [len(raw), len(raw) - 1]
    assert [one.size for one in candidates(raw[:-1], raw)[0].damaged_request(0)] == [len(raw) - 1]
    assert list(candidates(damaged)[0].damaged_request(0)) == []


def test_burst_is_one_damaged_frame_only_where_frames_are_never_glued() -> None:
    burst = b"\x11\x43\x55" + READ + b"\x77\x66"
    for glue, is_one in ((costs.NEVER_GLUED + 1, True), (costs.GLUED, False)):
        found, bus_model = candidates(burst, glue=glue)
        sizes = [one.size for one in found.damaged(0, bus_model.state)]
        assert (len(burst) in sizes) is is_one


def test_burst_of_a_frame_with_stray_bytes_is_no_damaged_frame() -> None:
    burst = b"\xff\xf8" + READ + b"\x00"
    found, bus_model = candidates(burst, glue=costs.NEVER_GLUED + 1)
    assert len(burst) not in [one.size for one in found.damaged(0, bus_model.state)]


# What the candidates cost.


def damages(data: bytes, *heard: bytes, silent_at: tuple[int, ...] = ()) -> dict[int, float]:
    """The costs of the damaged frames at the first byte, by size; none is repaired."""
    found, bus_model = candidates(data, *heard, silent_at=silent_at)
    every = list(found.damaged(0, bus_model.state))
    assert [one.repaired for one in every] == [b""] * len(every)
    return {one.size: one.cost for one in every}


BROKEN = ANSWER[:5] + bytes((ANSWER[5] ^ 0x18, ANSWER[6] ^ 0x42)) + ANSWER[7:]
"""The response with four wrong bits, which no repair explains."""


def test_damaged_response_that_is_due_costs_its_bytes_and_may_have_lost_some() -> None:
    due = costs.DAMAGED + costs.EXPECTED_CONTENT + 9 * costs.SKIP_PER_BYTE
    shorter = due + costs.DAMAGED_OTHER_SIZE
    assert damages(BROKEN + READ, READ) == {9: due, 8: shorter, 7: shorter}


def test_silences_inside_a_damaged_frame_cost_extra() -> None:
    due = costs.DAMAGED + costs.EXPECTED_CONTENT + 9 * costs.SKIP_PER_BYTE
    shorter = due + costs.DAMAGED_OTHER_SIZE + costs.SPLIT
    torn = {9: due + costs.SPLIT, 8: shorter, 7: shorter}
    assert damages(BROKEN + READ, READ, silent_at=(4,)) == torn
    torn[9] += costs.SPLIT_MORE
    assert damages(BROKEN + READ, READ, silent_at=(4, 8)) == torn


def test_damaged_frame_that_is_not_due_costs_more_and_has_lost_nothing() -> None:
    not_due = costs.DAMAGED + costs.UNEXPECTED_DAMAGED
    assert damages(BROKEN) == {size: not_due + size * costs.SKIP_PER_BYTE for size in (8, 9)}


def test_damaged_frame_that_is_cut_off_has_lost_bytes_only_as_far_as_it_was_heard() -> None:
    shorter = costs.DAMAGED + costs.EXPECTED_CONTENT + costs.DAMAGED_OTHER_SIZE
    shorter += 9 * costs.SKIP_PER_BYTE
    assert damages(BROKEN[:8], READ) == {8: shorter, 7: shorter}
    assert damages(BROKEN[:7], READ) == {7: shorter}
    assert damages(BROKEN[:6], READ) == {}
    assert damages(BROKEN[:3], READ) == {}


def test_exception_response_with_a_wrong_crc_loses_one_byte_at_most() -> None:
    """A frame has at least four bytes."""
    refusal = bytes.fromhex("01 83 02 55 AA")
    assert set(damages(refusal, READ)) == {5, 4}


def test_repaired_frame_costs_more_the_longer_it_is_and_for_each_silence() -> None:
    wrong = flipped(ANSWER, 5)
    whole = costs.ONE_WRONG_BIT + costs.RARE_ONE_BIT + 9 * costs.ONE_WRONG_BIT_PER_BYTE
    for silent_at, extra in (((), 0.0), ((4,), costs.SPLIT)):
        found, bus_model = candidates(wrong + READ, READ, silent_at=silent_at)
        (one,) = [one for one in found.damaged(0, bus_model.state) if one.repaired]
        assert (one.size, one.role, one.repaired) == (9, RESPONSE, ANSWER)
        assert one.cost == whole + extra


def test_burst_with_damage_costs_its_bytes_up_to_a_limit() -> None:
    for size in (9, 20, 48, 49, 100):
        burst = b"\x11\x43" + b"\x55" * (size - 2)
        found, bus_model = candidates(burst, glue=costs.NEVER_GLUED + 1)
        (one,) = found.damaged(0, bus_model.state)
        start = costs.SKIP + costs.DAMAGED_OTHER_SIZE + costs.UNEXPECTED_DAMAGED
        assert one.cost == start + min(size * costs.SKIP_PER_BYTE, costs.MAX_DAMAGED_LENGTH)


def test_burst_of_at_most_eight_bytes_is_no_damaged_frame() -> None:
    """Nor is one on a line whose frames are hardly ever glued, or one without a silence before."""
    burst = b"\x11\x43" + b"\x55" * 7
    never, hardly = costs.NEVER_GLUED + 1, costs.NEVER_GLUED
    for data, at, glue in ((burst[:8], 0, never), (burst, 0, hardly), (b"\x55" + burst, 1, never)):
        found, bus_model = candidates(data, glue=glue)
        assert list(found.damaged(at, bus_model.state)) == []


def test_frame_between_more_than_three_stray_bytes_does_not_explain_a_burst() -> None:
    for before in range(5):
        for behind in range(5):
            burst = b"\x00" * before + b"\x42\x43\x55\x55\x55\x55\x55"
            burst = burst[:before] + rtu_adu(0x42, burst[before + 1 :]) + b"\xff" * behind
            found, bus_model = candidates(burst, glue=costs.NEVER_GLUED + 1)
            sizes = [one.size for one in found.damaged(0, bus_model.state)]
            assert (len(burst) in sizes) is (max(before, behind) > 3), (before, behind)


def test_known_request_that_is_damaged_costs_its_bytes_and_silences() -> None:
    raw = next(
        raw
        for quantity in range(1, 256)
        if (raw := rtu_adu(1, bytes((1, 2, 7, 0, quantity))))[-1] == 0
    )
    cost = costs.DAMAGED + costs.EXPECTED_CONTENT + 8 * costs.SKIP_PER_BYTE
    for silent_at, extra in (((), 0.0), ((4,), costs.SPLIT)):
        found, _ = candidates(raw[:-1] + b"\x04", raw, silent_at=silent_at)
        assert [(one.size, one.cost) for one in found.damaged_request(0)] == [
            (8, cost + extra),
            (7, cost + costs.DAMAGED_OTHER_SIZE + extra),
        ]


def test_incomplete_frame_costs_little_per_byte_if_it_is_due() -> None:
    for size in range(2, 8):
        found, bus_model = candidates(ANSWER[:size], READ)
        content = costs.EXPECTED_CONTENT if size > 2 else 0.0
        assert found.incomplete(0, bus_model.state) == (
            True,
            content + (costs.INCOMPLETE + size * costs.INCOMPLETE_DUE_PER_BYTE),
        )


def test_incomplete_frame_that_is_not_due_costs_more() -> None:
    for size in range(2, 8):
        found, bus_model = candidates(READ[:size])
        unexpected = costs.INCOMPLETE + costs.INCOMPLETE_UNEXPECTED
        assert found.incomplete(0, bus_model.state) == (
            False,
            unexpected + size * costs.INCOMPLETE_PER_BYTE,
        )


def test_incomplete_frame_of_one_byte_tells_nothing() -> None:
    found, bus_model = candidates(b"\x01", READ)
    assert found.incomplete(0, bus_model.state) == (False, costs.INCOMPLETE)


def test_incomplete_request_that_is_known_or_counts_its_bytes_is_due() -> None:
    write = rtu_adu(9, bytes.fromhex("10 0000 0002 04 0001 0002"))
    for data, *heard in ((READ[:6], READ), (write[:8],)):
        found, bus_model = candidates(data, *heard)
        bus_model.reset_state()
        due = costs.INCOMPLETE + len(data) * costs.INCOMPLETE_DUE_PER_BYTE
        assert found.incomplete(0, bus_model.state) == (True, costs.EXPECTED_CONTENT + due)


def test_incomplete_frame_of_unknown_form_has_no_size() -> None:
    unexpected = costs.INCOMPLETE + costs.INCOMPLETE_UNEXPECTED + 5 * costs.INCOMPLETE_PER_BYTE
    found, bus_model = candidates(b"\x01\x41\x01\x02\x03")
    assert found.incomplete(0, bus_model.state) == (False, costs.UNKNOWN_FORM_BURST + unexpected)
    asked = rtu_adu(1, b"\x41\x01")
    found, bus_model = candidates(b"\x01\x41\x01\x02\x03", asked)
    due = costs.INCOMPLETE + 5 * costs.INCOMPLETE_DUE_PER_BYTE
    assert found.incomplete(0, bus_model.state) == (True, costs.UNKNOWN_FORM_BURST + due)


def test_nothing_is_incomplete_if_no_byte_may_follow_or_256_are_there() -> None:
    found, bus_model = candidates(READ[:5], may_continue=False)
    assert found.incomplete(0, bus_model.state) is None
    longest = b"\x01\x03\xfb" + bytes(252)
    assert candidates(longest)[0].incomplete(0, bus_model.state) is not None
    assert candidates(b"\x01\x41" + bytes(254))[0].incomplete(0, bus_model.state) is None


# Silences, and frames inside others.


def test_each_silence_inside_a_segment_counts() -> None:
    found, _ = candidates(READ + ANSWER, silent_at=(1, 4, 7, 8))
    assert found.split_cost(0, 1) == found.split_cost(1, 3) == found.split_cost(8, 9) == 0
    assert found.split_cost(0, 2) == found.split_cost(0, 4) == costs.SPLIT
    assert found.split_cost(0, 5) == costs.SPLIT + costs.SPLIT_MORE
    assert found.split_cost(0, 8) == costs.SPLIT + 2 * costs.SPLIT_MORE
    assert found.split_cost(0, 17) == costs.SPLIT + 3 * costs.SPLIT_MORE


def test_longest_silence_inside_a_frame_is_told_to_the_nanosecond() -> None:
    found, _ = candidates(READ + ANSWER, silent_at=(1, 4, 8))
    assert [one.inside_ns for one in found.frames(0)] == [SILENCE_NS + 4]
    assert [one.inside_ns for one in found.frames(8)] == [0]


def test_frame_after_a_silence_inside_a_segment_is_no_coincidence() -> None:
    data = b"\x01\x03\x20" + READ + READ + b"\x55" * 20
    found, _ = candidates(data, silent_at=(3, 11))
    silences = costs.SPLIT + costs.SPLIT_MORE
    assert found.inside_cost(0, 36) == silences + 2 * costs.CRC_COINCIDENCE
    assert found.inside_cost(0, 15) == silences + 2 * costs.CRC_COINCIDENCE
    assert found.inside_cost(0, 14) == silences + costs.CRC_COINCIDENCE
    assert found.inside_cost(3, 20) == costs.SPLIT + costs.CRC_COINCIDENCE
    assert candidates(data)[0].inside_cost(0, 36) == 0
    assert candidates(data)[0].inside_cost(0, 36, known=False) == costs.CRC_COINCIDENCE


def test_unknown_frame_between_silences_counts_as_a_frame_inside() -> None:
    held = rtu_adu(7, b"\x41\x02")
    data = b"\x01\x03\x20" + held + b"\x55" * 20
    assert candidates(data, silent_at=(3, 8))[0].inside_cost(0, 28) == (
        costs.SPLIT + costs.SPLIT_MORE + costs.CRC_COINCIDENCE
    )
    assert candidates(data, silent_at=(3,))[0].inside_cost(0, 28) == costs.SPLIT
    shortest = b"\x01\x03\x20" + rtu_adu(7, b"\x41") + b"\x55" * 20
    assert candidates(shortest, silent_at=(3, 7))[0].inside_cost(0, 27) == (
        costs.SPLIT + costs.SPLIT_MORE + costs.CRC_COINCIDENCE
    )


# Frames of unknown form.

VENDOR = rtu_adu(1, bytes.fromhex("41 0102 03"))


def unknown(data: bytes, *silent_at: int, at: int = 0) -> dict[tuple[int, bool], float]:
    """The costs of the frames of unknown form, by size and by whether only the CRC bounds them."""
    found, _ = candidates(data, silent_at=silent_at)
    return {(one.segment.size, one.is_unbound): one.cost for one in found.unknown_frames(at)}


def test_unknown_form_costs_less_if_silences_bound_it() -> None:
    assert unknown(VENDOR) == {(7, False): costs.UNKNOWN_FORM_BURST}
    assert unknown(VENDOR + READ) == {(7, True): costs.UNKNOWN_FORM}
    assert unknown(VENDOR + READ, 7) == {(7, False): costs.UNKNOWN_FORM_BURST}
    assert unknown(READ + VENDOR, at=8) == {(7, True): costs.UNKNOWN_FORM}


def test_each_zero_after_an_unknown_form_costs_more() -> None:
    """A frame with a correct CRC that ends in 00 has a correct CRC without it, too."""
    burst, end, more = costs.UNKNOWN_FORM_BURST, costs.ENDS_IN_ZERO, costs.ENDS_IN_ZERO_MORE
    assert unknown(VENDOR + bytes(1)) == {
        (8, False): burst + end - costs.ZERO_BEFORE_SILENCE,
        (7, False): burst,
    }
    assert unknown(VENDOR + bytes(2) + READ) == {
        (7, True): costs.UNKNOWN_FORM,
        (8, True): costs.UNKNOWN_FORM + end,
        (9, True): costs.UNKNOWN_FORM + end + more,
    }
    assert unknown(VENDOR + bytes(4), 11) == {
        (11, False): burst + end + 3 * more - costs.ZERO_BEFORE_SILENCE,
        (7, False): burst,
        (8, False): burst + end,
        (9, False): burst + end + more,
    }


def test_known_function_of_another_form_is_malformed() -> None:
    odd = rtu_adu(1, bytes.fromhex("03 0000"))
    assert unknown(odd) == {(6, False): costs.UNKNOWN_FORM_BURST + costs.MALFORMED}
    assert unknown(odd + READ) == {}


def test_longer_echo_of_function_08_is_not_malformed() -> None:
    longer = rtu_adu(5, bytes.fromhex("08 0000 A537 0001 0002"))
    assert unknown(longer) == {(12, False): costs.UNKNOWN_FORM_BURST}
    assert unknown(longer + READ) == {(12, True): costs.UNKNOWN_FORM}


def test_frame_of_three_bytes_is_none() -> None:
    assert unknown(VENDOR[:3]) == {}
    shortest = rtu_adu(7, b"\x41")
    assert unknown(shortest) == {(4, False): costs.UNKNOWN_FORM_BURST}


def test_pdu_that_breaks_its_rules_makes_a_frame_malformed() -> None:
    odd = rtu_adu(1, bytes.fromhex("03 01 05"))
    found, _ = candidates(READ + odd)
    assert [one.cost for one in found.frames(0)] == [0.0]
    assert [one.cost for one in found.frames(8)] == [costs.MALFORMED]


def test_frames_inside_a_frame_of_unknown_form_cost_extra() -> None:
    """One may be chance; of several, each but one costs a correct CRC."""
    for count, inside in (
        (0, 0.0),
        (1, costs.UNKNOWN_CRC_COINCIDENCE),
        (2, costs.CRC_COINCIDENCE),
        (3, 2 * costs.CRC_COINCIDENCE),
    ):
        whole = rtu_adu(1, b"\x41" + READ * count + b"\x01")
        assert unknown(whole + ANSWER)[len(whole), True] == inside + costs.UNKNOWN_FORM
