"""Recordings of logic analysers with their channels inverted, exchanged and added to."""

from __future__ import annotations

import io
import re
import zipfile
from typing import TYPE_CHECKING

import pytest

from mbtool.core import WireEvent
from mbtool.workflows.shared.reading import Reading, ReadingOptions

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mbtool.devices import NamedTransaction

pytestmark = pytest.mark.public_captures

SIGROK = "sigrokproject__sigrok-dumps"
LINES = {
    "brainchild-io-16do": (0, 1),
    "flowmeter_graph_tool": (2,),
    "flowmeter_target0_val0": (2,),
    "flowmeter_target_0liter_per_min": (2,),
}
"""The recordings, each with the numbers of the channels of its line."""
SPARE = 4
"""A channel that no recording uses."""


def both(sample: int, lines: tuple[int, ...]) -> int:
    """A channel that rests low, with what all channels of the line carry."""
    return int(all(sample >> line & 1 for line in lines))


def changed(path: Path, change: Callable[[int], int]) -> bytes:
    """A recording with the first eight channels of each sample changed."""
    table = bytes(change(sample) & 0xFF for sample in range(256))
    out = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "metadata":
                probes = "".join(f"probe{number}=D{number}\n" for number in range(1, 9))
                text = re.sub(r"probe\d+=.*\n", "", data.decode()).rstrip("\n")
                unit = int(re.findall(r"unitsize=(\d)", text)[0])
                data = f"{text}\n{probes}".encode()
            if name.startswith("logic-1"):
                samples = bytearray(data)
                samples[::unit] = samples[::unit].translate(table)
                data = bytes(samples)
            new.writestr(name, data)
    return out.getvalue()


def told(path: Path) -> list[tuple[object, ...]]:
    records = Reading([str(path)], ReadingOptions()).records()
    transactions: list[NamedTransaction] = [
        one for one in records if not isinstance(one, WireEvent)
    ]
    return [(one.request_raw, one.response_raw, one.outcome) for one in transactions]


@pytest.mark.parametrize("name", LINES)
def test_polarity_order_and_further_channels_change_no_transaction(
    name: str, public_captures: Path, tmp_path: Path
) -> None:
    path = public_captures / SIGROK / f"{name}.sr"
    if not path.exists():
        pytest.skip("this recording is not there")
    lines = LINES[name]
    changes: dict[str, Callable[[int], int]] = {
        "all inverted": lambda sample: ~sample,
        "exchanged": lambda sample: int(f"{sample:08b}"[::-1], 2),
        "exchanged and inverted": lambda sample: ~int(f"{sample:08b}"[::-1], 2),
        "a copy": lambda sample: sample | both(sample, lines) << SPARE,
        "an inverted copy": lambda sample: sample | (1 - both(sample, lines)) << SPARE,
        "a channel that is low": lambda sample: sample & ~(1 << SPARE),
        "a channel that is high": lambda sample: sample | 1 << SPARE,
    }
    for line in lines:
        changes[f"channel {line} inverted"] = (1 << line).__xor__
    expected = told(path)
    assert len(expected) >= 9
    for what, change in changes.items():
        file = tmp_path / f"{what}.sr"
        file.write_bytes(changed(path, change))
        assert told(file) == expected, what
