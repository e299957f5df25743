"""What a request of a connection, and the acknowledgements, say of a response."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from mbtool.decode.open_requests import OpenRequest
from mbtool.decode.stream_progress import AduPlace
from mbtool.modbus.adu import Adu, Transport, mbap_adu
from tests.decode.test_pairing import asked, told

READ = "03 006B 0002"
VALUES = "03 04 0001 0002"


def opened(request: Adu | None, place: AduPlace | None = None) -> OpenRequest:
    return OpenRequest(number=1, since_ns=0, adu=request, place=place)


def whole(response: Adu) -> Adu:
    return replace(response, raw=mbap_adu(response.transaction_id or 0, 1, response.pdu))


@pytest.mark.parametrize(
    ("response", "unit", "can"),
    [(VALUES, 1, True), ("83 02", 1, True), (VALUES, 2, False), ("04 02 0001", 1, False)],
)
def test_a_response_of_another_unit_or_function_answers_another_request(
    response: str, unit: int, can: bool
) -> None:
    assert opened(asked(READ, 0, 1)).can_get(told(response, 5, 1, unit), None) is can
    assert opened(None).can_get(told(response, 5, 1, unit), None)


@pytest.mark.parametrize(
    ("request_place", "response_place", "can", "is_next"),
    [
        # The response's sender had received the request, and the request's not the response.
        (AduPlace(100, 50), AduPlace(63, 100), True, True),
        (AduPlace(100, 50), AduPlace(63, 99), False, False),
        (AduPlace(100, 50), AduPlace(63, 101), True, False),
        (AduPlace(100, 62), AduPlace(63, 100), True, False),
        (AduPlace(100, 63), AduPlace(63, 100), False, False),
        (AduPlace(100, 49), AduPlace(63, 100), True, False),
        (AduPlace(100, None), AduPlace(63, 100), True, False),
        (AduPlace(100, 50), AduPlace(63, None), True, False),
        (AduPlace(100, 63), AduPlace(63, None), False, False),
        (None, AduPlace(63, 100), True, False),
        (AduPlace(100, 63), None, True, False),
    ],
)
def test_acknowledgements_tell_which_was_sent_first(
    request_place: AduPlace | None, response_place: AduPlace | None, can: bool, is_next: bool
) -> None:
    response = whole(told(VALUES, 5, 1))
    assert response.size == 13
    for request in (asked(READ, 0, 1), None):
        one = opened(request, request_place)
        assert one.can_get(response, response_place) is can
        if can:
            assert one.is_next_to(response, response_place) is is_next


@pytest.mark.parametrize(
    ("request_pdu", "response_pdu", "missing", "fits"),
    [
        (READ, VALUES, 0, True),
        (READ, "83 02", 0, True),
        (READ, "03 02 0001", 0, False),
        (READ, "03 04", 4, True),
        (READ, "03 04", 3, False),
        (READ, "03 06", 6, False),
        ("06 0001 0003", "06 0001 0003", 0, True),
        ("06 0001 0003", "06 0001 0004", 0, False),
        ("06 0001 0003", "06 0001", 2, True),
        ("41 00", "41 00 13", 0, True),
        ("41 00", "41 00", 1, True),
    ],
)
def test_a_response_fits_by_its_form_and_by_what_it_repeats(
    request_pdu: str, response_pdu: str, missing: int, fits: bool
) -> None:
    request = asked(request_pdu, 0, 1)
    response = replace(whole(told(response_pdu, 5, 1)), missing=missing)
    assert opened(request).fits(response) is fits
    # Nobody knows what a request asks for of which the capture lacks bytes, or all.
    assert opened(replace(request, missing=1)).fits(response)
    assert opened(None).fits(response)


@pytest.mark.parametrize(
    ("request_pdu", "transport", "sizes"),
    [
        (READ, Transport.TCP, (13, 9)),
        (READ, Transport.RTU_TCP, (9, 5)),
        ("06 0001 0003", Transport.TCP, (12, 9)),
        ("41 00", Transport.TCP, ()),
    ],
)
def test_a_request_tells_the_size_of_its_response_and_of_an_exception(
    request_pdu: str, transport: Transport, sizes: tuple[int, ...]
) -> None:
    request = replace(asked(request_pdu, 0, 1), transport=transport)
    assert opened(request).response_sizes() == sizes
    assert opened(replace(request, missing=1)).response_sizes() == ()
    assert opened(None).response_sizes() == ()


def test_a_request_that_the_capture_lacks_has_no_id_and_no_function() -> None:
    one, other = opened(asked(READ, 0, 7)), opened(None)
    assert (one.transaction_id, one.function) == (7, 3)
    assert (other.transaction_id, other.function) == (None, None)
