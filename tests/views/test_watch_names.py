"""Names of points are shortened before their values are cut."""

from __future__ import annotations

from mbtool.devices import PointValue
from mbtool.views.watch_names import short_name, with_short_names


def point(name: str, reference: str = "D1") -> PointValue:
    return PointValue(name=name, reference=reference, value=1, text="1")


def shortened(text: str, width: int, *names: str) -> str:
    spans = with_short_names([(text, "")], [point(name) for name in names], width)
    return "".join(part for part, _ in spans)


SERIES = "CH1 digital value", "CH2 digital value"
TEXT = "digital value: CH1 12000, CH2 4000"


def test_names_lose_letters_first_and_the_shared_one_is_left_out_then() -> None:
    assert shortened(TEXT, 34, *SERIES) == TEXT
    assert shortened(TEXT, 33, *SERIES) == "dig. value: CH1 12000, CH2 4000"
    assert shortened(TEXT, 30, *SERIES) == "CH1 12000, CH2 4000"
    assert shortened("CH2 digital value 7", 10, *SERIES) == "CH2 7"


def test_the_name_of_a_lone_point_is_left_out_whole() -> None:
    name = "A/D conversion setting"
    assert shortened(f"0102H {name}: CH1 enabled", 20, name) == "0102H CH1 enabled"


def test_names_of_several_points_keep_their_beginnings() -> None:
    names = "Initial data setting flag", "Error reset request flag"
    text = f"{names[0]}: on; {names[1]}: off"
    assert shortened(text, 40, *names) == "Ini. data..: on; Error reset..: off"


def test_a_name_that_is_the_reference_stays() -> None:
    assert shortened("X0 X1 on", 3, "D1") == "X0 X1 on"


def test_a_name_that_looks_like_a_pattern_is_only_a_name() -> None:
    assert shortened(r"CH1 a\1 (x) 7; CH2 a\1 (x) 8", 20, r"CH1 a\1 (x)", r"CH2 a\1 (x)") == (
        "CH1 7; CH2 8"
    )


def test_a_name_alone_is_shortened_only_if_it_has_no_room() -> None:
    assert short_name("CH1 digital operation value", 27) == "CH1 digital operation value"
    assert short_name("CH1 digital operation value", 26) == "CH1 dig. ope. value"
