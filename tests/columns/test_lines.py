"""The lines made of blocks are those of the transactions one by one, to the byte."""

from __future__ import annotations

import random
from pathlib import Path
from unittest.mock import patch

import pytest

from mbtool.columns import plain_lines, portions
from tests.columns import both_ways
from tests.columns.both_ways import damaged, differing_texts, generated
from tests.columns.disturbed_captures import disturbed
from tests.columns.test_equality import MOST_BYTES, every_form, poll
from tests.packets.building import Talk, pcap

OWN = Path(__file__).resolve().parents[2] / "captures"


def test_each_form_of_pdu_gives_equal_lines() -> None:
    assert differing_texts(every_form()) == []


@pytest.mark.parametrize("number", range(16))
def test_disturbed_captures_give_equal_lines(number: int) -> None:
    rng = random.Random(f"lines {number}")
    capture = disturbed(number) if number % 2 else generated(number)
    with patch.object(portions, "MOST_VALUES", rng.choice((30, portions.MOST_VALUES))):
        assert differing_texts(damaged(capture, rng), rng.choice((17, 100, 65_536))) == []


@pytest.mark.parametrize("name", ["100 %s%.pcap", "=1+1.pcap", '"b", c.pcap', "\x7f\u00e4.pcap"])
def test_names_of_files_stand_in_the_lines_as_they_are(name: str) -> None:
    talk = Talk()
    capture = pcap([*talk.handshake(), *poll(talk, 9)])
    with patch.object(both_ways, "NAME", name):
        assert differing_texts(capture) == []


def test_lines_with_marks_are_made_anew_above_their_limit() -> None:
    with patch.object(plain_lines, "MAX_LINES", 1):
        assert differing_texts(generated(3), 40) == []


def test_the_captures_of_the_repository_give_equal_lines() -> None:
    captures = sorted(OWN.glob("**/*.pcap"))
    assert len(captures) > 100
    for path in captures:
        assert differing_texts(path.read_bytes()) == [], path


@pytest.mark.public_captures
def test_captures_made_by_others_give_equal_lines(public_captures: Path) -> None:
    differing = {}
    for path in sorted(public_captures.glob("**/*.pcap*")):
        if path.suffix in (".pcap", ".pcapng") and path.stat().st_size <= MOST_BYTES:
            found = differing_texts(path.read_bytes(), 97)
            if found:
                differing[path.name] = found
    assert differing == {}
