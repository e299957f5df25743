"""Ports that run at another rate than the one that was asked for."""

from __future__ import annotations

import os
import sys
import termios
from typing import TYPE_CHECKING

import pytest

from mbtool.core import LinkError
from mbtool.ports.real_rate import demand_rate, real_rate

if TYPE_CHECKING:
    from collections.abc import Iterator

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")


@pytest.fixture
def at_9600() -> Iterator[int]:
    near, far = os.openpty()
    settings = termios.tcgetattr(far)
    settings[4] = settings[5] = termios.B9600
    termios.tcsetattr(far, termios.TCSANOW, settings)
    yield far
    os.close(near)
    os.close(far)


def test_a_port_at_another_rate_is_refused_with_both(at_9600: int) -> None:
    assert real_rate(at_9600) == 9600
    with pytest.raises(LinkError, match="does not do 230400 baud, and has set 9600"):
        demand_rate(at_9600, "/dev/ttyS1", 230400)


@pytest.mark.parametrize("baud", [9600, 9615, 9400])
def test_a_rate_that_a_divider_gives_is_near_enough(at_9600: int, baud: int) -> None:
    demand_rate(at_9600, "/dev/ttyS1", baud)


def test_where_nothing_is_known_nothing_is_refused() -> None:
    with open(os.devnull, "rb") as file:
        assert real_rate(file.fileno()) is None
        demand_rate(file.fileno(), "/dev/null", 9600)
