"""Signals that are wishes."""

from __future__ import annotations

import signal

import pytest

from mbtool.cli.talk import interruptible


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_is_a_wish_and_the_second_ends_at_once(number: int) -> None:
    before = signal.getsignal(number)
    with interruptible() as interrupt:
        assert not interrupt.wait(0)
        signal.raise_signal(number)
        assert interrupt.wait(0)
        assert interrupt.asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before
