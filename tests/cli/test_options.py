"""What the options that commands share mean."""

from __future__ import annotations

import pytest

from mbtool.cli.options import assignments, condition
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
