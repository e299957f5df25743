"""Holds the inventory of captures made by others against what tshark says is in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from mbtool.devices import builtin_profiles, load_profile
from mbtool.ledger.identification import FITS, identify
from mbtool.ledger.inventory import inventory
from tests.captures import FOLDER, public_folder
from tests.differential.inventory_truth import (
    EXPLAINED,
    captures_with_adus,
    differences,
    main,
    taken,
)

if TYPE_CHECKING:
    from pathlib import Path

MOST_BYTES = 300_000
"""Larger captures are left to `python -m tests.differential.inventory_truth`."""


@pytest.mark.public_captures
def test_hosts_units_functions_and_ranges_are_those_of_the_truth_and_no_profile_fits(
    public_captures: Path,
) -> None:
    """No device of these captures is one of the built-in profiles."""
    profiles = [load_profile(name) for name in builtin_profiles()]
    small = [one for one in captures_with_adus(public_captures) if one.stat().st_size < MOST_BYTES]
    assert len(small) > 20
    for path in small:
        document = inventory(taken(path), identify=lambda one: identify(one, profiles))
        count = EXPLAINED.get(path.name, (0, ""))[0]
        found = differences(path, document)
        assert len(found) == count, (path.name, found[:3])
        fits = [row.fit for row in document.slaves if row.fit is not None]
        assert [one for one in fits if one.profile is not None or one.score > FITS] == []


def test_a_folder_without_captures_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))
    assert main(public_folder()) == 3
    assert str(tmp_path) in capsys.readouterr().err
