"""The table of all rules of `mbtool check`: code, severity, meaning and source."""

# docs/findings.md has a section for each row, with an example; a test compares the two.
#
# A rule of the standard has a code like MB-101: a family and a number. A rule of a device's manual
# has a code like FT1A-Q16: the profile's prefix, a letter for the kind of rule, and the function
# code in decimal (for the letter E, the exception code), so that users can select the rule for one
# function. The code does not contain the limit in the manual, so it stays the same when the limit
# is corrected. A code never changes its meaning.
#
# Sources, each with its section: MODBUS Application Protocol Specification V1.1b3, MODBUS over
# Serial Line V1.02, MODBUS Messaging on TCP/IP Implementation Guide V1.0b; the devices' manuals.

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """The severity of a finding. The values are the levels of SARIF, a file format for findings."""

    ERROR = "error"
    """A request cannot have a correct response, or a response is incorrect."""
    WARNING = "warning"
    """Something may work in one case and fail in another."""
    NOTE = "note"
    """A fact is worth knowing, but need not be a fault."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule of the standard, or one kind of rule that devices' manuals have."""

    code: str
    """The code of a rule of the standard, such as MB-101; or one letter, such as Q, for a kind of
    rule in devices' manuals."""
    severity: Severity
    meaning: str
    """A sentence for the user that says what breaks the rule."""
    source: str

    @property
    def is_of_devices(self) -> bool:
        """True if this is a kind of rule in devices' manuals, with one letter as its `code`."""
        return len(self.code) == 1


_E, _W, _N = Severity.ERROR, Severity.WARNING, Severity.NOTE
_MANUAL = "manual of the device, as its profile has it"
_FA3 = "manual of the FA3 modules"
_SECURITY = "ours, to find attacks; no document asks for it"

_ROWS = (
    # Rules of devices' manuals.
    ("F", _E, "The device's manual does not list the function.", _MANUAL),
    ("Q", _E, "The quantity is 0 or more than the device's manual allows for the function.",
     _MANUAL),
    ("L", _N, "The quantity is more than a doubtful figure of the device's manual allows.",
     _MANUAL),
    ("A", _E, "The function addresses what the device's manual does not have.", _MANUAL),
    ("W", _E, "The function writes where the device's manual lets a master only read.", _MANUAL),
    ("D", _E, "The request has other data than the device's manual fixes for the function.",
     _MANUAL),
    ("V", _W, "A value is written that is outside the range in the device's manual.", _MANUAL),
    ("E", _W, "The device gave an exception code that its manual does not list.", _MANUAL),
    ("C", _E, "The device gave an exception code that its manual has for another cause.", _MANUAL),
    ("R", _E, "The response has another form than the device's manual states.", _MANUAL),
    ("M", _W, "The response has a code that the device's manual does not list.", _MANUAL),
    ("U", _E, "The unit is none that the device's manual allows.", _MANUAL),
    # Rules about requests.
    ("MB-101", _E, "A request's byte count does not agree with its quantity, or with its bytes.",
     "Application Protocol 6.11, 6.12, 6.17"),
    ("MB-102", _E, "A request does not have the form of its function.", "Application Protocol 6"),
    ("MB-103", _E, "Function 05 writes a value other than 0000H and FF00H.",
     "Application Protocol 6.5"),
    ("MB-104", _E, "The quantity is 0 or more than the standard allows for the function.",
     "Application Protocol 6.1 to 6.4, 6.11, 6.12, 6.17"),
    ("MB-105", _W, "In a write of coils the bits behind the last coil are not 0.",
     "Application Protocol 6.11"),
    ("MB-106", _E, "A range goes on behind address FFFFH, the last there is.",
     "Application Protocol 4.4, 7"),
    ("MB-107", _E, "A request has function code 00H, or one from 80H on, which mark exceptions.",
     "Application Protocol 4.1"),
    ("MB-108", _E, "A unit above 247 is on a serial line.", "Serial Line 2.2"),
    ("MB-109", _N, "A request has a function code that the standard reserves.",
     "Application Protocol, Annex A"),
    # Rules about responses.
    ("MB-201", _E, "A write's answer does not repeat its request.",
     "Application Protocol 6.5, 6.6, 6.11, 6.12, 6.16"),
    ("MB-202", _E, "An answer's byte count does not agree with the request, or with its bytes.",
     "Application Protocol 6.1 to 6.4, 6.17"),
    ("MB-203", _E, "An answer does not have the form of its function.", "Application Protocol 6"),
    ("MB-204", _W, "In an answer the bits behind the last one asked for are not 0.",
     "Application Protocol 6.1, 6.2"),
    # Rules about broadcasts.
    ("MB-301", _E, "A broadcast is answered.", "Serial Line 2.1"),
    ("MB-302", _W, "A broadcast reads, where it can only write.", "Serial Line 2.1"),
    # Rules about requests without responses, and responses without requests.
    ("MB-401", _W, "A request has no answer.", "Serial Line 2.4.1; TCP/IP guide 4.4.1"),
    ("MB-402", _W, "A request was answered only after the master had sent it again.",
     "Serial Line 2.4.1"),
    ("MB-403", _W, "A slave says what no request asked for.",
     "Serial Line 2.1; TCP/IP guide 4.4.2"),
    ("MB-404", _N, "A request that comes at regular times comes early or late.",
     "measured; no document asks for it"),
    # Rules about the silences and bytes of a serial line.
    ("RTU-101", _W, "Inside a frame the line is silent for longer than t1.5.",
     "Serial Line 2.5.1.1"),
    ("RTU-102", _W, "Inside a frame the line is silent for t3.5 or longer, which ends it.",
     "Serial Line 2.5.1.1"),
    ("RTU-103", _W, "Between two frames the line is silent for less than t3.5.",
     "Serial Line 2.5.1.1"),
    ("RTU-104", _N, "Frames are glued or torn so often that silences tell nothing; adapters do so.",
     "measured; docs/links.md"),
    ("RTU-201", _W, "The CRC or LRC of a frame is wrong.", "Serial Line 2.5.1.2, 2.5.2.2"),
    ("RTU-202", _W, "Bytes on the line are no frame.", "Serial Line 2.5.1.1"),
    ("RTU-203", _W, "The port's driver heard damaged characters.", "Serial Line 2.5.1, 2.5.2"),
    ("RTU-204", _E, "Little or nothing of a line can be read: its settings are probably wrong.",
     "Serial Line 2.5.1, 2.5.2"),
    ("RTU-301", _W, "A request follows sooner than the device's manual has a master wait.",
     _MANUAL),
    ("RTU-302", _N, "After a broadcast the master waits less than 100 ms.",
     "Serial Line 2.4.1, turnaround delay"),
    # Rules about Modbus/TCP connections.
    ("TCP-101", _W, "Two requests of a connection are open at once with one transaction id.",
     "TCP/IP guide 3.1.3, 4.4.1"),
    ("TCP-102", _W, "An answer does not repeat its request's transaction id.",
     "TCP/IP guide 3.1.3"),
    ("TCP-103", _W, "The protocol id is not 0, so the message is none of Modbus.",
     "TCP/IP guide 3.1.3"),
    ("TCP-104", _W, "An answer does not repeat its request's unit.", "TCP/IP guide 3.1.3"),
    ("TCP-201", _W, "A connection to a Modbus port carries another protocol.", "TCP/IP guide 4.2"),
    ("TCP-202", _W, "Bytes in a Modbus/TCP connection are no ADU.", "TCP/IP guide 3.1.3"),
    ("TCP-203", _W, "A TCP retransmission has other bytes than the first copy.", "RFC 9293, 3.8.1"),
    # Rules about attacks and scans.
    ("SEC-101", _W, "A second master writes to a slave.", _SECURITY),
    ("SEC-102", _W, "A master writes to a slave more often than plants do.", _SECURITY),
    ("SEC-103", _W, "A command stops or restarts a device.",
     "Application Protocol 6.8.1; published analyses of function 5AH"),
    ("SEC-201", _W, "A host asks many addresses, and polls none of them.", _SECURITY),
    ("SEC-202", _W, "A master asks many units, and polls none of them.", _SECURITY),
    ("SEC-203", _W, "A master asks a unit for many functions that it does not have.", _SECURITY),
    ("SEC-204", _W, "A unit refuses a master many different registers.", _SECURITY),
    ("SEC-205", _N, "A host that is new on the network reads the identification of a slave.",
     "Application Protocol 6.13, 6.21; manual of the FA3 modules, 10.4, function 42H"),
    # Rules for single families of devices.
    ("FA3-X1", _E, "The protocol id is not 0, and an FA3 module gives no answer at all.",
     f"{_FA3}, 10.4, message format"),
    ("FA3-X2", _W, "A third connection makes the module drop the one that was silent longest.",
     f"{_FA3}, 10.2"),
    ("FA3-X3", _N, "A remote reset: no answer, the connection drops, none is taken for 2 s.",
     f"{_FA3}, 10.4, function 41H"),
    ("FA3-X4", _W, "The module is spoken to within the 2 s after its remote reset.",
     f"{_FA3}, 10.4, function 41H"),
    ("FA3-X5", _W, "The initial data setting is out of order: Y9 on, then X9 seen on, then Y9 off.",
     f"{_FA3}, 10.5"),
    ("FA3-X6", _W, "Values are read or written after settings, but Y9 did not put them in force.",
     f"{_FA3}, 10.5"),
    ("FA3-X7", _W, "A reset after alive checks that got no answer: the master or network fails.",
     f"{_FA3}, 10.3"),
    ("FA3-X8", _W, "A request in parts further apart than 00F5H says (30 s): alarm 0E40H.",
     f"{_FA3}, 10.3"),
    ("FA3-X9", _E, "The module refuses or keeps a connection against its manual.",
     f"{_FA3}, 10.2; 10.4, function 41H"),
    ("FA3-X10", _W, "A value is read although its conversion completion flag was last read as off.",
     f"{_FA3}, 10.5"),
    ("FA3-X11", _W, "The module reports an alarm in RWr1.", f"{_FA3}, 10.3"),
    ("FA3-X12", _E, "The model name (42H) is another one than was named.",
     f"{_FA3}, 10.4, function 42H"),
    ("WAGO-X1", _W, "One exception 04 after another: the coupler's watchdog has run out.",
     "manual of the WAGO 750, watchdog"),
)  # fmt: skip

RULES = {row[0]: Rule(*row) for row in _ROWS}
"""The rules by their code. For a rule of devices' manuals, the key is its letter."""

_OF_A_DEVICE = re.compile(r"(?P<prefix>.+)-(?P<letter>[A-Z])(?P<number>\d{1,3})", re.ASCII)


@dataclass(frozen=True, slots=True)
class DeviceCode:
    """The parts of the code of a finding about a device's manual.

    In FT1A-Q16 they are the profile's prefix FT1A, the kind of rule with the letter Q, and the
    function code 16 (for the letter E, an exception code).
    """

    prefix: str
    rule: Rule
    number: int

    @classmethod
    def parse(cls, code: str) -> DeviceCode | None:
        match = _OF_A_DEVICE.fullmatch(code)
        rule = RULES.get(match["letter"]) if match is not None else None
        if match is None or rule is None:
            return None
        return cls(match["prefix"], rule, int(match["number"]))


def rule_of(code: str) -> Rule | None:
    """The rule of a finding's code; None if this version of mbtool does not know the code."""
    rule = RULES.get(code)
    if rule is not None:
        return rule
    parsed = DeviceCode.parse(code)
    return parsed.rule if parsed is not None else None


def severity_of(code: str) -> Severity:
    """The severity of a finding; a warning if the code is unknown."""
    rule = rule_of(code)
    return rule.severity if rule is not None else Severity.WARNING
