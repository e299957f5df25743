"""What Wireshark is told of the interface."""

from __future__ import annotations

import re

from mbtool.core.local_ports import LocalSerialPort
from mbtool.devices import builtin_profiles, load_profile
from mbtool.views.extcap_dialog import dialog_text, interfaces_text, link_types_text

PORTS = [LocalSerialPort(device="/dev/ttyUSB0", description="a {strange}\nadapter")]
SENTENCE = re.compile(r"(extcap|interface|dlt|arg|value) (?:\{[a-z]+=[^{}]*\})+")


def _sentences(text: str) -> list[dict[str, str]]:
    """Each line's word and values; fails for a line of another form."""
    lines = text.splitlines()
    assert all(SENTENCE.fullmatch(line) for line in lines), lines
    return [
        {"word": line.partition(" ")[0], **dict(re.findall(r"\{([a-z]+)=([^{}]*)\}", line))}
        for line in lines
    ]


def test_there_is_one_interface_for_frames_of_ipv4() -> None:
    program, interface = _sentences(interfaces_text("1.2"))
    assert (program["word"], program["version"]) == ("extcap", "1.2")
    assert (interface["word"], interface["value"]) == ("interface", "mbtool")
    (dlt,) = _sentences(link_types_text())
    assert dlt["number"] == "228"


def test_the_dialog_has_selectors_and_strings_only() -> None:
    sentences = _sentences(dialog_text(PORTS, [load_profile(name) for name in builtin_profiles()]))
    controls = [one for one in sentences if one["word"] == "arg"]
    assert [one["call"] for one in controls] == [
        "--port", "--path", "--baud", "--format", "--mode", "--device", "--devices"
    ]  # fmt: skip
    assert {one["type"] for one in controls} == {"selector", "string"}
    for control in controls:
        choices = [one for one in sentences if one.get("arg") == control["number"]]
        assert bool(choices) == (control["type"] == "selector")
        assert [one["default"] for one in choices].count("true") == bool(choices)


def test_a_port_is_shown_with_its_description() -> None:
    port, other = [one for one in _sentences(dialog_text(PORTS, [])) if one.get("arg") == "0"]
    assert (port["value"], port["display"]) == ("/dev/ttyUSB0", "/dev/ttyUSB0 a (strange) adapter")
    assert other["value"] == "none"


def test_without_a_port_another_is_to_be_named() -> None:
    (choice,) = [one for one in _sentences(dialog_text([], [])) if one.get("arg") == "0"]
    assert (choice["value"], choice["default"]) == ("none", "true")
