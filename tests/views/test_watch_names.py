"""Names of points are shortened before their values are cut."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.devices import PointValue, describe_points
from mbtool.views.watch_names import cut_name, with_short_names
from tests.ledger.requests import request

if TYPE_CHECKING:
    from mbtool.views.watch_columns import Spans


def point(name: str, text: str, reference: str = "D1") -> PointValue:
    return PointValue(name=name, reference=reference, value=None, text=text)


def texts_of(spans: Spans, width: int, *points: PointValue) -> list[str]:
    short = with_short_names(spans, request(points=list(points)), width)
    return [text for text, _ in short]


def shortened(width: int, *points: PointValue, before: str = "") -> str:
    (text,) = texts_of([(before + "; ".join(describe_points(points)), "")], width, *points)
    return text


SERIES = point("CH1 digital value", "12000"), point("CH2 digital value", "4000")


def test_names_lose_their_ends_first_and_the_shared_one_is_left_out_then() -> None:
    assert shortened(34, *SERIES) == "digital value: CH1 12000, CH2 4000"
    assert shortened(33, *SERIES) == "digital val…: CH1 12000, CH2 4000"
    assert shortened(31, *SERIES) == "digital v…: CH1 12000, CH2 4000"
    assert shortened(30, *SERIES) == "CH1 12000, CH2 4000"


def test_values_that_have_just_changed_keep_their_labels() -> None:
    lit: Spans = [("CH2 digital value 4000", "bold"), (" ", ""), ("CH1 digital value: 12000", "")]
    assert texts_of(lit, 45, *SERIES) == ["CH2 digital val… 4000", " ", "CH1 digital val…: 12000"]
    assert texts_of(lit, 20, *SERIES) == ["CH2 4000", " ", "CH1 12000"]


def test_the_name_of_a_lone_point_is_left_out_whole() -> None:
    lone = point("A/D conversion setting", "CH1 enabled")
    assert shortened(20, lone, before="0102H ") == "0102H CH1 enabled"
    assert texts_of([("A/D conversion setting CH1 enabled", "bold")], 20, lone) == ["CH1 enabled"]


def test_names_of_several_points_keep_their_beginnings() -> None:
    points = point("Initial data setting flag", "on"), point("Error flag", "off")
    assert shortened(40, *points) == "Initial data setti…: on; Error flag: off"
    assert shortened(9, *points) == "Initial d…: on; Error flag: off"


def test_a_name_that_is_the_reference_stays() -> None:
    named = point("RWr0", "initial 7", "RWr0"), point("RWr1", "initial 8", "RWr1")
    assert shortened(3, *named) == "RWr0 initial 7, RWr1 initial 8"
    lone = point("Initial data setting flag", "on")
    assert shortened(3, lone, *named) == "on; RWr0 initial 7, RWr1 initial 8"


def test_a_name_that_looks_like_a_pattern_is_only_a_name() -> None:
    points = point(r"CH1 a\1 (x)", "7"), point(r"CH2 a\1 (x)", "8")
    assert shortened(15, *points) == "CH1 7, CH2 8"


def test_the_words_of_a_name_stay_in_values_and_in_other_names() -> None:
    flags = point("CH1 error flag", "error flag cleared"), point("CH2 error flag", "no error")
    assert shortened(20, *flags) == "CH1 error flag cleared, CH2 no error"
    ends = point("CH1 condition", "good"), point("CH2 condition", "precondition: bad")
    assert shortened(44, *ends) == "condition: CH1 good, CH2 precondition: bad"
    assert shortened(40, *ends) == "CH1 good, CH2 precondition: bad"


def test_a_name_alone_is_shortened_only_if_it_has_no_room() -> None:
    assert cut_name("CH1 digital operation value", 27) == "CH1 digital operation value"
    assert cut_name("CH1 digital operation value", 26) == "CH1 digital operation val…"
    assert cut_name("CH1 digital operation value", 13) == "CH1 digital…"
