"""Texts on troubles that several commands tell."""

from __future__ import annotations

from mbtool.views.trouble_words import worst_stray_frames


def test_the_links_with_most_stray_frames_are_named_and_the_others_counted() -> None:
    frames = {f"line {number}": number for number in range(1, 8)}
    assert worst_stray_frames(frames, most=2) == [
        "line 7 has 7 frames with a wrong CRC that no unit can be blamed for",
        "line 6 has 6 frames with a wrong CRC that no unit can be blamed for",
        "5 more links with such frames",
    ]
    assert worst_stray_frames({}, most=2) == []
    assert len(worst_stray_frames({"line": 1}, most=1)) == 1
