"""What the options that commands share mean."""

from __future__ import annotations

import pytest

from mbtool.cli.options import PortOptions, SilenceOptions, assignments, condition, file_line
from mbtool.core import UsageError
from tests.logs.samples import transaction


def test_devices_are_assigned() -> None:
    (one,) = assignments(["5=idec-ft1a-touch"])
    assert (str(one.who), one.profile.name) == ("5", "idec-ft1a-touch")
    assert list(assignments(None)) == []


def test_one_device_has_one_profile() -> None:
    with pytest.raises(UsageError, match="is given two profiles"):
        assignments(["5=idec-ft1a-touch", "5=fa3-at1m8x"])


def test_without_a_condition_everything_is_wanted() -> None:
    assert condition(None)(transaction())
    assert not condition("unit == 9")(transaction())


def test_a_line_is_named_or_not() -> None:
    assert file_line(None) is None
    assert str(file_line("rtu@9600")) == "rtu@9600-8E1"
    with pytest.raises(UsageError, match="rtu@19200-8E1 or ascii@9600-7E1"):
        file_line("tcp")


def test_a_silence_is_given_or_not() -> None:
    t1_5, t3_5, timeout = SilenceOptions(t3_5="28bits").read()
    assert (t1_5, str(t3_5), timeout) == (None, "28bits", None)
    assert str(SilenceOptions(response_timeout="200ms").read()[2]) == "200ms"
    with pytest.raises(UsageError, match=r"^--t3-5: silence 'long': write a number and bits"):
        SilenceOptions(t3_5="long").read()


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (None, ([], [], False)),
        (["502", "1502"], ([502, 1502], [], False)),
        (["any"], ([], [], True)),
        (["any", "1502"], ([1502], [], True)),
    ],
)
def test_ports_are_numbers_or_any(
    texts: list[str] | None, expected: tuple[list[int], list[int], bool]
) -> None:
    assert PortOptions(texts).tcp_ports() == expected


@pytest.mark.parametrize("text", ["0", "65536", "all", "-1", "٥"])
def test_a_port_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="a number from 1 to 65535, or any"):
        PortOptions([text]).tcp_ports()


@pytest.mark.parametrize("text", ["0", "65536", "any", "x"])
def test_a_port_of_rtu_is_a_number(text: str) -> None:
    assert PortOptions(None, ["502", "4001"]).tcp_ports() == ([], [502, 4001], False)
    with pytest.raises(UsageError, match=r"'--rtu-port': .*a number from 1 to 65535$"):
        PortOptions(None, [text]).tcp_ports()


def test_a_port_speaks_one_of_both() -> None:
    assert PortOptions(["any"], ["502"]).tcp_ports() == ([], [502], True)
    with pytest.raises(UsageError, match=r"port 502 is named by --port, .*and by --rtu-port"):
        PortOptions(["1502", "502"], ["502"]).tcp_ports()
