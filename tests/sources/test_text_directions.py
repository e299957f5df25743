"""The directions of frames in text logs, measured on conversations whose truth is known."""

from __future__ import annotations

import pytest

from tests.sources.text_directions import groups, total


@pytest.mark.parametrize("group", [*groups()], ids=lambda group: group[0])
def test_99_of_100_frames_are_found_and_have_the_right_direction(group: tuple) -> None:  # type: ignore[type-arg]
    _, forms, transport, swapped = group
    score = total(1, forms, transport, swapped=swapped)
    assert score.found >= 0.99 * score.frames
    assert score.right >= 0.99 * score.found
