"""The table of texts: severity, cause and remedy of each kind of trouble."""

# docs/troubles.md has a section for each row, with a picture of the bytes or packets; a test
# compares the two. In the templates, {who}, {link}, {count}, {of} and {when} are fields of the
# Trouble; the other names are its figures. If a cause has no {when}, it is added at the end.
# Troubles of equal severity are listed in the order of the rows.

from __future__ import annotations

from dataclasses import dataclass

from mbtool.devices.checking.rules import Severity


@dataclass(frozen=True, slots=True)
class Words:
    """The words of one kind of trouble."""

    code: str
    severity: Severity
    cause: str
    """A clause that says what is wrong; names in braces are replaced by figures."""
    remedy: str
    """An imperative that says what to do; names in braces are replaced by figures."""
    noun: str = "unit"
    """The noun by which several troubles with this code are counted: unit, link, master."""
    short: str = ""
    """The fault in a few words, for the row of a unit or link, with names in braces as in `cause`.
    If it is empty, the row shows the code."""
    explains: tuple[str, ...] = ()
    """The codes of broken rules and other troubles that this trouble causes; they are not
    reported."""


_E, _W, _N = Severity.ERROR, Severity.WARNING, Severity.NOTE

_BLAMED = ("UNIT-SILENT", "UNIT-MISSING")
"""Troubles of units that a trouble of their line may cause: answers that did not come."""
_DAMAGED = ("UNIT-BAD-CRC", "LINE-STRAY")
"""Troubles for damaged frames, which a trouble of the line may cause."""

_ROWS = (
    # The serial line.
    Words(
        "LINE-SETTINGS", _E,
        "{bytes} bytes of {link} are no frame, and no frame is right{when}: baud rate, parity or "
        "mode differ from those of the listener",
        "listen again with rtu:PORT@auto, which finds the settings; if only a part of the "
        "recording is so, look who changed them then",
        "line", "settings wrong",
        ("RTU-201", "RTU-202", "RTU-203", "RTU-204", "POLL-PAUSED", "LINE-NOISE", "LINE-LOST-BYTES",
         "LINE-SAME-UNIT", "LINE-FOREIGN", "LINE-BIAS", *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-ONE-SIDE", _E,
        "only {side} are heard at {link}, no {lacking}",
        "listen also where the {lacking} are: the other pair of a four-wire line, the other port, "
        "or in front of the converter",
        "line", "only {side} heard",
        ("RTU-101", "RTU-102", "RTU-103", "RTU-104", "RTU-202", "MB-202", "MB-401", "MB-403",
         *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-TWO-MASTERS", _E,
        "two masters share {link}: their requests collide or interrupt each other ({count} times)"
        "{polls}",
        "let one master poll for both, or put a gateway between them and the line, which takes "
        "their requests in turn",
        "line", "two masters",
        ("RTU-101", "RTU-102", "RTU-103", "RTU-201", "RTU-202", "MB-104", "MB-106", "MB-401",
         "MB-402", "MB-403", "POLL-LATE", "UNIT-SLOW", "UNIT-MALFORMED", "LINE-LATE", *_BLAMED,
         *_DAMAGED),
    ),
    Words(
        "LINE-SAME-UNIT", _E,
        "two slaves answer as {who}{other}: {count} of {of} answers collide or come twice ({how})",
        "give one of them another address; to find it, take them off the line one by one",
        "unit", "two slaves with this address",
        ("RTU-101", "RTU-102", "RTU-103", "RTU-201", "RTU-202", "MB-102", "MB-104", "MB-106",
         "MB-401", "MB-402", "MB-403", *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-LATE", _E,
        "{who} answers {latency} after the request, the master waits {timeout}: {count} of {of} "
        "answers come too late",
        "raise the master's time-out above {longest}, or ask for less in one request",
        "unit", "{count} answers after the time-out",
        ("RTU-103", "RTU-202", "MB-104", "MB-106", "MB-401", "MB-402", "MB-403", "POLL-LATE",
         "UNIT-SLOW", "LINE-SAME-UNIT", "LINE-NOISE", "LINE-LOST-BYTES", *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-LOST-BYTES", _W,
        "bytes are missing in {count} frames of {link} ({percent}), {where}",
        "look at the receiver: a full FIFO, a busy computer or a slow adapter; a latency timer or "
        "buffer that is too small loses bytes, too",
        "line", "lost bytes",
        ("RTU-201", "RTU-202", "MB-401", "MB-402", "MB-403", "POLL-LATE", *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-NOISE", _W,
        "{count} frames of {link} are damaged ({percent}), {where}",
        "check the cable there, its shield, termination, bias and ground, and what runs beside it",
        "line", "damaged frames",
        ("RTU-201", "RTU-202", "MB-401", "MB-402", "MB-403", "POLL-LATE", *_BLAMED, *_DAMAGED),
    ),
    Words(
        "LINE-BIAS", _W,
        "a byte {byte} that nobody sends stands {places} ({count} times) at {link}: {why}",
        "{remedy}",
        "line", "stray {byte}",
        ("RTU-202", "RTU-103", "RTU-104", "LINE-NOISE", "LINE-LOST-BYTES"),
    ),
    Words(
        "LINE-FOREIGN", _W,
        "{share} of the bytes of {link} are another protocol ({form}), while {answered} of the "
        "requests are answered",
        "find the device that talks another protocol on these wires, and give it a line of its own",
        "line", "another protocol",
        ("RTU-201", "RTU-202", "RTU-204", "MB-403", "LINE-NOISE", "LINE-LOST-BYTES",
         "LINE-SAME-UNIT", "UNIT-MISSING", *_DAMAGED),
    ),
    Words(
        "LINE-REPEATED", _W,
        "frames come twice at {link}: {count} of {of} responses are copies of the one before",
        "look for a repeater, a converter or a second tap that sends or records each frame again",
        "line", "frames twice", ("MB-403", "RTU-103", "LINE-ECHO", "UNIT-MISSING"),
    ),
    Words(
        "LINE-ECHO", _N,
        "the adapter at {link} hears what it sends: {count} requests come twice",
        "switch off the echo of the adapter (its receiver while it sends), or leave it: the copies "
        "are left out",
        "line", "echo", ("RTU-103",),
    ),
    # The network.
    Words(
        "NET-ONE-SIDE", _E,
        "only {side} of {link} are in the recording, no {other} ({count} transactions)",
        "record both directions: mirror both of the port, or listen at another place",
        "link", "only {side} recorded",
        ("UNIT-SILENT", "UNIT-MISSING", "MB-401", "MB-403", "SEC-201", "SEC-202"),
    ),
    Words(
        "NET-TWO-MACS", _E,
        "{who} has two MAC addresses in its own network: {macs}",
        "look who has the second one: a device with the same IP address, or somebody who answers "
        "for it (ARP spoofing)",
        "host", "two MAC addresses",
    ),
    Words(
        "NET-LATE", _E,
        "{who} answers after {latency}, the master sends its next request after {timeout}: {count} "
        "of {of} answers come too late",
        "raise the master's time-out above {longest}, or ask for less in one request",
        "unit", "{count} answers after the time-out", ("POLL-LATE", "TCP-101", "UNIT-SLOW"),
    ),
    Words(
        "NET-BLOCKED", _W,
        "{who} holds up the line behind its gateway for {held} each time: {count} requests to "
        "{units} waited for it",
        "mend or remove that unit, shorten the gateway's time-out for it, or poll it more rarely",
        "unit", "holds up the line", ("UNIT-MISSING", "UNIT-SLOW", "POLL-LATE", "MB-401", "MB-402"),
    ),
    Words(
        "NET-SHARED", _W,
        "{masters} ask {link} at once, and it serves one request at a time: {count} of {of} "
        "requests wait for {wait} behind those of another master",
        "let one master poll for the others, or poll more rarely: behind a gateway is one line, "
        "which all masters share",
        "link", "masters wait for each other", ("POLL-LATE", "UNIT-SLOW", "NET-DELAYED-ACK"),
    ),
    Words(
        "NET-ROLE", _W,
        "{who}, which answered as a slave, sends requests itself to {asked}",
        "find out if that is meant; a device that was taken over does so, too",
        "host", "slave that asks",
    ),
    Words(
        "NET-DELAYED-ACK", _N,
        "{messages} of {who} {how}: a sender waits for a delayed acknowledgement",
        "let master or slave send each message in one piece, or switch off Nagle's algorithm "
        "(TCP_NODELAY)",
        "sender", "delayed acknowledgements", ("POLL-LATE", "UNIT-SLOW"),
    ),
    Words(
        "NET-LOSSY", _W,
        "{count} of {of} messages between {who} and {link} are sent again{held}: packets "
        "are lost on the way, or acknowledged too late",
        "look at cables, radio links and the counters of errors of each switch port on the way "
        "(a wrong duplex mode loses packets under load, too)",
        "link", "{count} messages sent again", ("POLL-LATE",),
    ),
    Words(
        "NET-LOST", _W,
        "{connections} to {link} lost: {ends}{meanwhile}",
        "look who sends the reset or refuses: the slave's limit of connections, a firewall, or a "
        "restart",
        "link", "connections lost", ("UNIT-MISSING", "MB-401", "POLL-PAUSED"),
    ),
    # Units.
    Words(
        "UNIT-SILENT", _E,
        "{who} never answers ({requests})",
        "{check}; poll it more rarely until then, as each request costs the master's time-out",
        "unit", "never answers", ("MB-401",),
    ),
    Words(
        "UNIT-BAD-CRC", _E,
        "{who} answers {requests}{when}{part} with a wrong CRC",
        "check the cable, shield, termination and ground to this unit, and its baud rate",
        "unit", "{percent} wrong CRC", ("RTU-201", "MB-401", "MB-402"),
    ),
    Words(
        "UNIT-MISSING", _E,
        "{who} leaves {requests}{when}{part} without an answer",
        "{look}; see what was sent before each case",
        "unit", "{percent} unanswered", ("MB-401", "MB-402"),
    ),
    Words(
        "UNIT-MALFORMED", _E,
        "{who} gives {requests}{when}{part} a malformed answer",
        "ask the maker of the device; what it sends does not have the form of the function",
        "unit", "{percent} malformed", ("MB-202", "MB-203"),
    ),
    Words(
        "UNIT-REFUSES", _W,
        "{who} refuses {requests}{when}{part}, {codes}",
        "{advice}",
        "unit", "{percent} refused",
    ),
    Words(
        "NET-SCANNED", _W,
        "{units} refuse {requests}, {codes}: {different} different ones, as in a scan{by}",
        "find out what runs there, and if it may ask",
        "link", "scanned",
    ),
    Words(
        "UNIT-SLOW", _W,
        "{who} is slow: half of its answers take {median} or more, those of most others "
        "{usual} or less",
        "give it a time-out of its own, poll it more rarely, or ask less in one request",
        "unit", "slow, {median}",
    ),
    Words(
        "UNIT-SLOWER", _W,
        "{who} answers slower{since}: in {mean} on average, before in {before}",
        "find out what changed then in the device or behind it: load, firmware, a gateway's line",
        "unit", "slower{since}, {mean}",
    ),
    # Values.
    Words(
        "VALUE-NOT-VALID", _W,
        '{who} says "{text}" in {value} ({times} of {of}){more}',
        "do not use the values that this is about; look at their sensors and wires",
        "unit", 'says "{text}"',
    ),
    Words(
        "VALUE-NONE", _W,
        "{value} of {who} is {word} ({number}) in {times} of {of}, which means no value in many "
        "devices{more}",
        "let the master take it as missing, look why the device has no value then, and write "
        "no_value into the profile",
        "unit", "{value} without a value",
    ),
    Words(
        "VALUE-RANGE", _W,
        "{value} of {who} is {number} ({times} of {of}); its profile allows {range}{more}",
        "check the sensor and its wires, or correct the range in the profile",
        "unit", "{value} out of range",
    ),
    Words(
        "VALUE-STUCK", _W,
        "{value} of {who} stays at {number} for {rest}, while values beside it move as "
        "before{more}",
        "compare it with what it measures: a sensor, or the program that copies the value, may "
        "have stopped",
        "unit", "{value} stuck",
    ),
    Words(
        "VALUE-JUMPED", _W,
        "{value} of {who} jumps from {before} to {after}, while its steps are at most {usual} "
        "otherwise{more}",
        "look at what happened then: a loose contact, a disturbed wire, or halves of a number that "
        "were read at different times make such values",
        "unit", "{value} jumped",
    ),
    Words(
        "VALUE-RESET", _W,
        "{value} of {who} only rises, and falls from {before} to {after}{more}",
        "find out if the device restarted or was set back then, and let what adds up the counter "
        "expect it",
        "unit", "{value} reset",
    ),
    Words(
        "VALUE-BACKWARDS", _W,
        "{value} of {who} only rises otherwise, and runs back from {before} to {after}{more}",
        "look at what counts: a turned direction, a replaced device, or halves of a number that "
        "were read at different times",
        "unit", "{value} ran backwards",
    ),
    # Polling.
    Words(
        "POLL-LATE", _W,
        "{who} gives {late} late, {longest} (usually {usual})",
        "look at what the unit does then; a master's time-out must be longer than that",
        "unit", "{late} late",
    ),
    Words(
        "POLL-PAUSED", _W,
        "{who} paused a poll{of_link} {paused} (usually every {usual})",
        "look at what the master did then: a restart, other work, or waiting for another slave",
        "master", "paused",
    ),
    Words(
        "NET-SHORT", _W,
        "{who} opened {opened} TCP connections to {link} for {requests}",
        "let the master keep one connection open",
        "link", "a connection for each poll",
    ),
    # What no unit can be blamed for.
    Words(
        "LINE-STRAY", _W,
        "{link} has {frames} with a wrong CRC that no unit can be blamed for",
        "check cable, termination, bias and ground; listen at another place of the line",
        "line", "wrong CRC", ("RTU-201",),
    ),
)  # fmt: skip

WORDS = {row.code: row for row in _ROWS}
