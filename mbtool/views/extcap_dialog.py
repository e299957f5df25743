"""Answers Wireshark's questions about mbtool's interface for serial lines, as text."""

# Wireshark calls each program in its extcap folder and asks which interfaces it has, their link
# types, and what the user can set. Each answer is a line of text, `word {key=value}...` (Wireshark,
# extcap(4)). Only controls of the types selector and string are used, because Wireshark 4.0 refuses
# editselector.
#
# Braces would end a value, so _safe() replaces those in names from profiles and adapters.

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mbtool.packets.line_packets import RAW_IPV4

if TYPE_CHECKING:
    from mbtool.core.local_ports import LocalSerialPort
    from mbtool.devices import Profile

INTERFACE = "mbtool"
AUTO, NONE = "auto", "none"
BAUDS = (AUTO, "1200", "2400", "4800", "9600", "19200", "38400", "57600", "115200")
FORMATS = ("8E1", "8N1", "8O1", "8N2", "7E1", "7O1", "7N2")
_HELP = "https://www.wireshark.org/docs/man-pages/extcap.html"


class _Choice(NamedTuple):
    value: str
    text: str


class _Control(NamedTuple):
    """A control of the dialog that Wireshark shows for mbtool's interface.

    The option has the same name on the command line of `mbtool extcap`.
    """

    option: str
    title: str
    hint: str
    choices: Sequence[_Choice] = ()
    """The choices of a selector, the default first. A control without choices is a text field."""


def interfaces_text(version: str) -> str:
    """Return the answer to --extcap-interfaces; `version` is that of mbtool."""
    return (
        f"extcap {{version={version}}}{{help={_HELP}}}{{display=mbtool}}\n"
        f"interface {{value={INTERFACE}}}{{display=Modbus serial line}}\n"
    )


def link_types_text() -> str:
    """Return the answer to --extcap-dlts: the pcap link type of decoded frames, which is raw IPv4.

    Bytes that are no frame have another link type, which only the pcapng file itself can state.
    """
    return (
        f"dlt {{number={RAW_IPV4}}}{{name=IPV4}}{{display=Modbus over UDP, as mbtool shows it}}\n"
    )


def dialog_text(ports: Sequence[LocalSerialPort], profiles: Sequence[Profile]) -> str:
    """Return the answer to --extcap-config: a line for each control and choice of the dialog."""
    lines = []
    for number, control in enumerate(_controls(ports, profiles)):
        kind = "selector" if control.choices else "string"
        lines.append(
            f"arg {{number={number}}}{{call={control.option}}}{{display={_safe(control.title)}}}"
            f"{{type={kind}}}{{tooltip={_safe(control.hint)}}}"
        )
        lines += [
            f"value {{arg={number}}}{{value={_safe(choice.value)}}}{{display={_safe(choice.text)}}}"
            f"{{default={'false' if index else 'true'}}}"
            for index, choice in enumerate(control.choices)
        ]
    return "".join(f"{line}\n" for line in lines)


def _controls(ports: Sequence[LocalSerialPort], profiles: Sequence[Profile]) -> list[_Control]:
    found = [_Choice(one.device, f"{one.device} {one.description}".strip()) for one in ports]
    devices = [_Choice(one.name, f"{one.name}: {one.title}") for one in profiles]
    return [
        _Control(
            "--port",
            "Serial port",
            "The port that hears the line; it is only read",
            [*found, _Choice(NONE, "another, named below")],
        ),
        _Control("--path", "Another port", "The path of a port that is not in the list"),
        _Control(
            "--baud",
            "Baud rate",
            "auto finds rate, format and mode by listening, which may take minutes",
            [_Choice(one, one) for one in BAUDS],
        ),
        _Control(
            "--format",
            "Character format",
            "Data bits, parity, stop bits; not used with auto",
            [_Choice(one, one) for one in FORMATS],
        ),
        _Control(
            "--mode",
            "Mode",
            "The form of frames",
            [_Choice("rtu", "RTU"), _Choice("ascii", "ASCII")],
        ),
        _Control(
            "--device",
            "Device",
            "The profile of all slaves: findings and exceptions in the words of its manual",
            [_Choice(NONE, "none"), *devices],
        ),
        _Control(
            "--devices",
            "Devices by unit",
            "UNIT=PROFILE, several with commas: 5=idec-ft1a-touch,7=chino-lt830",
        ),
    ]


def _safe(text: str) -> str:
    return "".join(
        one if one.isprintable() else " " for one in text.replace("{", "(").replace("}", ")")
    )
