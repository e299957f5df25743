"""The language of --where."""

from __future__ import annotations

import re
import warnings
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from mbtool.core import UsageError
from mbtool.devices import NamedTransaction, PointValue
from mbtool.modbus import Outcome, Verdict
from mbtool.query.terms import NAMES
from mbtool.query.where import MAX_DEPTH, MAX_LENGTH, parse_where
from tests.logs.samples import transaction, transactions

READ = transaction(
    transaction_id=7,
    source="10.0.0.1:50211",
    destination="10.0.0.9:502",
    address=40,
    device="idec-ft1a-touch",
    reference="HR400041..400042",
    latency_ns=12_500_000,
    points=[PointValue(name="level", reference="HR400041", value=2.5, text="2.5 m")],
    findings=["FT1A-Q3"],
    verdicts=[Verdict.GLUED],
)
REFUSED = transaction(
    outcome=Outcome.EXCEPTION, exception=2, response_values=None, latency_ns=None, address=None
)


@pytest.mark.parametrize(
    ("expression", "read", "refused"),
    [
        ("unit == 1", True, True),
        ("unit != 1", False, False),
        ("function in (3, 16)", True, True),
        ("function in [4]", False, False),
        ("function not in (3, 16)", False, False),
        ('outcome == "exception"', False, True),
        ("exception == 2", False, True),
        ("latency_ms > 12", True, False),
        ("latency_ms <= 12.5", True, False),
        ("40 <= address < 50", True, False),
        ("4660 in values", True, False),
        ("values == (4660, 22136)", True, False),
        ("retries == -1", False, False),
        ('link == "rs485" and transport == "rtu"', True, True),
        ('source == "10.0.0.1:50211" or destination == "10.0.0.9:502"', True, False),
        ("transaction_id == 7", True, False),
        ("quantity >= 2", True, True),
        ('device == "idec-ft1a-touch"', True, False),
        ('"HR4" in reference', True, False),
        ('"level" in points', True, False),
        ('"FT1A-Q3" in findings', True, False),
        ('"glued" in verdicts', True, False),
        ("not unit == 1", False, False),
        ("not (unit == 2 or exception == 2)", True, False),
        ("unit == 1 and not function == 4 and retries == 0", True, True),
        (" unit == 1\n", True, True),
    ],
)
def test_an_expression_selects_transactions(expression: str, read: bool, refused: bool) -> None:
    wanted = parse_where(expression)
    assert (wanted(READ), wanted(REFUSED)) == (read, refused)


@pytest.mark.parametrize(
    ("fields", "registers", "bits"),
    [
        ({"function": 0x10, "address": 40, "quantity": 2}, [40, 41], None),
        ({"function": 0x06, "address": 40, "quantity": None}, [40], None),
        ({"function": 0x16, "address": 40, "quantity": None}, [40], None),
        (
            {
                "function": 0x17,
                "address": 1,
                "quantity": 9,
                "write_address": 40,
                "write_quantity": 3,
            },
            [40, 41, 42],
            None,
        ),
        ({"function": 0x05, "address": 40, "quantity": None}, None, [40]),
        ({"function": 0x0F, "address": 40, "quantity": 3}, None, [40, 41, 42]),
        ({"function": 0x03, "address": 40, "quantity": 2}, None, None),
        ({"function": 0x2B, "address": None, "quantity": None}, None, None),
        ({"function": 0x10, "address": None, "quantity": None}, None, None),
    ],
)
def test_what_a_request_writes_is_told_by_address(
    fields: dict[str, Any], registers: list[int] | None, bits: list[int] | None
) -> None:
    one = transaction(**fields)
    assert NAMES["written_registers"].value(one) == registers
    assert NAMES["written_bits"].value(one) == bits
    assert parse_where("40 in written_registers")(one) is (registers is not None)
    assert parse_where("40 in written_bits")(one) is (bits is not None)


@pytest.mark.parametrize("operator", ["==", "!=", "<", ">", "in", "not in"])
def test_a_name_that_does_not_apply_compares_as_false(operator: str) -> None:
    group = "(40, 41)" if "in" in operator else "40"
    assert not parse_where(f"address {operator} {group}")(REFUSED)
    if operator != "in":
        assert not parse_where(f"40 {operator.replace('not in', '!=')} address")(REFUSED)


def test_a_name_in_a_list_that_does_not_apply_cannot_be_ordered() -> None:
    for operator in ("<", ">"):
        assert parse_where(f"(1, address) {operator} (1, 2)")(REFUSED) is False


@pytest.mark.parametrize(
    ("expression", "why"),
    [
        (
            'outcome == "no_answer"',
            "outcome is never 'no_answer'; it is ok, exception, late, no-answer, "
            "not-captured, unsolicited, broadcast or malformed",
        ),
        ('"fine" != outcome', "outcome is never 'fine'; it is ok, "),
        ('outcome in ("ok", "fine")', "outcome is never 'fine'; it is ok, "),
        ('transport == "modbus"', "transport is never 'modbus'; it is "),
        ('"glue" in verdicts', "one of verdicts is never 'glue'; it is "),
        ('unit == "1"', "unit is a number and '1' is a text; they cannot be compared"),
        ('latency_ms < "5"', "latency_ms is a number and '5' is a text; they cannot be"),
        ("link > 1", "link is a text and 1 is a number; they cannot be compared"),
        ("unit == link", "unit is a number and link is a text; they cannot be compared"),
        ('unit in (1, "2")', "unit is a number and '2' is a text; they cannot be compared"),
        (
            "values == 4660",
            "values is a list of numbers and 4660 is a number; write 4660 in values",
        ),
        ("address == (40, 41)", "(40, 41) is a list of numbers; write address in (40, 41)"),
        ("points == 5", "points is a list of texts and 5 is a number; they cannot be compared"),
        ("5 in points", "5 is a number and one of points is a text; they cannot be compared"),
        ("(1, 2) in values", "(1, 2) is a list of numbers and one of values is a number"),
        ("unit in 5", "5 is a number, and in looks into a list: unit in (1, 2)"),
        ("5 not in unit", "unit is a number, and in looks into a list: unit in (1, 2)"),
        ("5 in reference", "5 is a number and reference is a text; they cannot be compared"),
        ("1 < unit < 'a'", "unit is a number and 'a' is a text"),
        ("not (unit == 1 or unit == 'a')", "unit is a number and 'a' is a text"),
    ],
)
def test_a_comparison_that_is_never_true_is_an_error_with_a_correction(
    expression: str, why: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(why)) as caught:
        parse_where(expression)
    assert str(caught.value).startswith(f"--where {expression!r}: ")


@pytest.mark.parametrize(
    "expression",
    [
        '"answer" in outcome',
        'outcome in ("ok", "no-answer")',
        'transport != "rtu-tcp"',
        "values == ()",
        "(1, unit) < values",
        "unit == 5.0",
        "source == destination",
        "unit in (function, 5)",
        '"HR" in "HR1"',
    ],
)
def test_a_comparison_that_can_be_true_is_accepted(expression: str) -> None:
    assert parse_where(expression)(READ) in (True, False)


@pytest.mark.parametrize(
    ("expression", "problem"),
    [
        ("", "--where '' is not an expression"),
        ("unit =", "--where 'unit =' is not an expression"),
        ("unit = 5", "--where 'unit = 5' is not an expression: write =="),
        ("unit == 5 and", "--where 'unit == 5 and' is not an expression"),
        ("unit == 1\0", "is not an expression"),
        ("unit", "'unit' is not a comparison"),
        ("unit + 1", "'unit + 1' is not a comparison"),
        ("print(unit)", "'print(unit)' is not a comparison"),
        ("unit if unit == 1 else unit", "is not a comparison"),
        ("unit == 1j", "'1j' is neither a name, a number nor a text"),
        ("unit == None", "'None' is neither a name, a number nor a text"),
        ("unit == link.upper", "'link.upper' is neither"),
        ("unit == values[0]", "'values[0]' is neither"),
        ("unit in ((1, 2), 3)", "'(1, 2)' is neither"),
        ("unit == -unit", "'-unit' is neither"),
        ('unit == f"{unit}"', "is neither"),
        ("unit is 5", "compare with == and !=, not with is"),
        ("unti == 5", "there is no 'unti', did you mean 'unit'? there are link, transport, "),
        ("__import__ == 5", "there is no '__import__'"),
    ],
)
def test_everything_but_comparisons_is_an_error_with_an_example(
    expression: str, problem: str
) -> None:
    with pytest.raises(UsageError, match=re.escape(problem)) as caught:
        parse_where(expression)
    assert "unit" in str(caught.value)


@pytest.mark.parametrize(
    ("expression", "told"),
    [
        ("unit=5", "not an expression: write =="),
        ("unit == 5 && function == 3", "not an expression: write and"),
        ("unit == 5 AND function = 3", "not an expression: write and"),
        ("unit => 5", "not an expression: write >="),
        ("!(unit == 5)", "not an expression: write not"),
        ("unit 17", "not an expression: write unit == 17"),
        ("link == 'a = b' and link 'c'", "not an expression: write link == 'c'"),
        ("outcome ok", 'not an expression: write outcome == "ok"'),
        ("reference like HR4*", "not an expression: write the text behind like in quotes"),
        ("time > 14:15:00", 'write a time in quotes: "2026-11-22T09:14:03"'),
        ("time > 2026-09-21T14:15", 'write a time in quotes: "2026-11-22T09:14:03"'),
        ("time > 2026-11-22", "'2026-11-22' is a moment; write \"2026-11-22\""),
        ("outcome == ok", "'ok' is a text; write \"ok\""),
        ("outcome == no-answer", "'no-answer' is a text; write \"no-answer\""),
        ("outcome == wrong-crc", "there is no 'wrong-crc'; a response with a wrong CRC or LRC is"),
        ("outcome == 'crc'", "outcome is never 'crc'; a response with a wrong CRC or LRC is found"),
        ("link == 'a = b' and", "is not an expression; for example"),
        ("reference like reference", "is not an expression: write the text behind like"),
    ],
)
def test_the_usual_mistakes_are_told_what_to_write(expression: str, told: str) -> None:
    with pytest.raises(UsageError, match=re.escape(told)):
        parse_where(expression)


@pytest.mark.parametrize(
    "expression",
    [
        "not " * MAX_DEPTH + "unit == 1",
        "not " * (MAX_LENGTH // 4 - 5) + "unit == 1",
        "(" * 1000 + "unit == 1" + ")" * 1000,
        "unit == " + "-" * 5000 + "1",
        "+".join(["1"] * 4000),
        "unit == " + "9" * 5000,
        "unit" + ".a" * 4000 + " == 1",
        "unit == 1 and " * 2000 + "unit == 1",
    ],
    ids=lambda text: text[:16],
)
def test_too_deep_or_too_long_expressions_are_a_short_error(expression: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_where(expression)
    assert len(str(caught.value)) < 500
    assert "\n" not in str(caught.value)


def test_expressions_up_to_the_limits_are_accepted() -> None:
    assert parse_where("not " * (MAX_DEPTH - 1) + "unit == 2")(READ) is True
    many = "unit in (" + "2, " * (MAX_LENGTH // 3 - 10) + "1)"
    assert parse_where(many)(READ) is True


def test_python_does_not_warn_of_a_text() -> None:
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        parse_where(r'link == "\d"')
    assert warned == []


_terms = st.one_of(
    st.sampled_from(sorted(NAMES)),
    st.integers(-3, 70_000).map(str),
    st.floats(allow_nan=False).map(repr).filter(lambda text: "inf" not in text),
    st.text(st.characters(codec="ascii"), max_size=5).map(repr),
    st.lists(st.sampled_from([*sorted(NAMES), "1", "'ok'"]), max_size=3).map(
        lambda items: f"[{', '.join(items)}]"
    ),
)
_operators = st.sampled_from(["==", "!=", "<", "<=", ">", ">=", "in", "not in"])
_comparisons = st.builds(
    lambda first, rest: " ".join([first, *(f"{operator} {term}" for operator, term in rest)]),
    _terms,
    st.lists(st.tuples(_operators, _terms), min_size=1, max_size=3),
)
_expressions = st.recursive(
    _comparisons,
    lambda inner: st.one_of(
        inner.map(lambda text: f"not ({text})"),
        st.builds(lambda a, b: f"({a}) and ({b})", inner, inner),
        st.builds(lambda a, b: f"({a}) or ({b})", inner, inner),
    ),
    max_leaves=6,
)


@given(_expressions, transactions)
def test_an_expression_says_yes_or_no_of_any_transaction(
    expression: str, one: NamedTransaction
) -> None:
    try:
        wanted = parse_where(expression)
    except UsageError:  # It can never hold.
        return
    assert wanted(one) in (True, False)


@given(st.text(max_size=40))
def test_any_text_is_an_expression_or_refused(text: Any) -> None:
    try:
        wanted = parse_where(text)
    except UsageError:
        return
    assert wanted(READ) in (True, False)


@pytest.mark.parametrize(
    "text",
    [
        'source == "10.0.0.66"',
        '"10.0.0.66" == source',
        'source in ("10.0.0.1", "10.0.0.66")',
        'source == "10.0.0.66:50000"',
        'destination == "fe80::1" and slave == "fe80::1"',
        'master == "10.0.0.66"',
        '"10.0" in source',
        'reference like "HR4*"',
        'reference like "HR40000?"',
        'reference not like "HR3*"',
        'reference not like "R4*"',
        r'reference matches "^HR4\d+$"',
        'not reference matches "IR"',
        'file like "*.pcap"',
        'findings like "FT1A-*"',
        'time >= "2023-11-14" and time < "2023-11-14T23:13:20.5+01:00"',
        "reference != \"x like 'y'\"",
    ],
)
def test_an_endpoint_a_time_or_a_pattern_holds(text: str) -> None:
    one = transaction(
        source="10.0.0.66:50000",
        destination="[fe80::1]:502",
        reference="HR400001",
        file="a.pcap",
        findings=["FT1A-Q3"],
    )
    assert parse_where(text)(one)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("unit == 300", "unit is never 300; it is a number from 0 to 255"),
        ("unit == 1e999", "unit is never 1e999; it is a number from 0 to 255"),
        ('link like "x*" and unit == -0x100', "unit is never -0x100; it is a number from 0"),
        ("300 == unit", "unit is never 300; it is a number from 0 to 255"),
        ("unit in (1, 300)", "unit is never 300"),
        ("unit > 255", "unit is never > 255"),
        ("70000 in written_registers", "one of written_registers is never 70000"),
        ('reference matches "(a"', "the pattern '(a': missing ), unterminated subpattern at char"),
        ('reference matches "a{99999999999}"', "the repetition number is too large"),
        ('unit like "1"', "unit is a number; like looks at texts"),
        ('outcome like "exep*"', "outcome never fits 'exep*'; it is ok, exception"),
        ('time > "soon"', "'soon' is no moment; write 2026-11-22T09:14:03"),
        ('master == "10.0.0.6:502"', "master has no port; write source == '10.0.0.6:502'"),
        ('slave == "10.0.0.11/1"', 'write slave == "10.0.0.11" and unit == 1'),
        ('destination in ("10.0.0.1", "10.0.0.9:502/3")', '== "10.0.0.9:502" and unit == 3'),
        ('master == "10.0.0.0/24"', 'no network prefix behind it; write master like "10.0.0.*"'),
        (
            'source in ("172.16.0.0/12",)',
            "source has no network prefix behind it; compare with like",
        ),
        ('slave == "fe80::/64"', "slave has no network prefix behind it; compare with like"),
        ("reference like 5", "is not an expression"),
        ("reference like device", "is not an expression"),
    ],
)
def test_what_can_never_hold_is_one_clear_line(text: str, why: str) -> None:
    with pytest.raises(UsageError, match=re.escape(why)) as told:
        parse_where(text)
    assert "\n" not in str(told.value)


def test_nothing_is_in_an_empty_list() -> None:
    for text in ("unit not in []", "unit == 1 or unit in ()"):
        assert parse_where(text)(transaction())
    assert not parse_where("unit in []")(transaction())


def test_limits_of_a_range_can_be_compared() -> None:
    for text in ("unit <= 255", "unit < 300", "unit >= 0", "-1 < unit", "address < 65536"):
        assert parse_where(text)(transaction())


def test_points_are_compared_by_name_and_their_numbers_are_among_the_values() -> None:
    one = replace(
        READ,
        points=[
            PointValue(name="Flow", reference="HR1", value=23.399999618530273, text="23.4 degC"),
            PointValue(name="State", reference="HR3", value=2, text="heating"),
        ],
    )
    for text in (
        'point["Flow"] > 23 and point["flow"] < 24',
        'text["State"] == "heating"',
        'text["State"] like "heat*"',
        "23.4 in values",
        "not 23.5 in values",
        'point["Flow"] == 23.4',
        '23.4000 == point["Flow"]',
    ):
        assert parse_where(text)(one), text
    assert not parse_where('point["Absent"] > 0')(one)
    with pytest.raises(UsageError, match="is a text and 8 is a number"):
        parse_where('text["State"] > 8')
