"""Texts of a profile that a table, a line of a log or a terminal can take."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbtool.core.errors import ProfileError
from mbtool.devices.loading import builtin_profiles, load_profile
from mbtool.devices.validation import validate_characters

TOUCH = load_profile("idec-ft1a-touch")


@pytest.mark.parametrize("name", builtin_profiles())
def test_built_in_profiles_have_none(name: str) -> None:
    validate_characters(load_profile(name), "built in")


def test_notes_may_have_lines_and_any_text_any_language() -> None:
    fields = {"notes": ["one\n\ttwo\r\nthree"], "title": "Pumpe №7 \u00a0°C 泵 \u00ad\U0001f6e2"}
    validate_characters(msgspec.structs.replace(TOUCH, **fields), "pump.toml")


@pytest.mark.parametrize("bad", ["\x1b[2J", "\n", "\x7f", "\x9b", "\u2029", "\ud800"])
def test_control_character_is_refused_wherever_it_stands(bad: str) -> None:
    for field in ("title", "vendor", "source"):
        with pytest.raises(ProfileError, match=f"pump.toml: {field}: .* control character"):
            validate_characters(msgspec.structs.replace(TOUCH, **{field: f"a{bad}"}), "pump.toml")


@given(st.text())
def test_messages_about_control_characters_are_printable(name: str) -> None:
    area = msgspec.structs.replace(TOUCH.areas[0], name=name, prefix="\x00")
    with pytest.raises(ProfileError) as caught:
        validate_characters(msgspec.structs.replace(TOUCH, areas=[area]), "pump.toml")
    assert str(caught.value).isprintable()
