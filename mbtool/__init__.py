"""Capture, decode and replay Modbus.

docs/python.md describes this interface. Nothing is loaded before it is used.
"""

# `import mbtool` must stay fast: the command line and the pytest plugin import it each time. So
# each public name is imported from its module only when it is first used (PEP 562).

from __future__ import annotations

from mbtool.version import __version__

TYPE_CHECKING = False  # Type checkers take this name for True; importing typing takes milliseconds.

if TYPE_CHECKING:
    from mbtool.api.byte_decoder import ByteDecoder as Decoder
    from mbtool.api.capture import Capture
    from mbtool.api.capture import open_capture as open  # noqa: A004
    from mbtool.api.live_capture import LiveCapture, sniff
    from mbtool.api.observed_shell import ObservedShell
    from mbtool.api.point_rows import PointRow
    from mbtool.api.serial_bench import SerialBench, line
    from mbtool.api.slaves import Replay, Slave
    from mbtool.core.errors import (
        CutError,
        DamageError,
        InputError,
        LinkError,
        MbtoolError,
        OutputError,
        ProfileError,
        UsageError,
    )
    from mbtool.core.evidence import EventKind, WireEvent
    from mbtool.devices.checking.finding import Finding
    from mbtool.devices.named_transaction import NamedTransaction, PointValue
    from mbtool.modbus.transaction import Outcome
    from mbtool.troubles.trouble import Trouble

_ERRORS = (
    "CutError", "DamageError", "InputError", "LinkError", "MbtoolError", "OutputError",
    "ProfileError", "UsageError",
)  # fmt: skip
_PLACES = {
    "Capture": ("api.capture", "Capture"),
    "Decoder": ("api.byte_decoder", "ByteDecoder"),
    "EventKind": ("core.evidence", "EventKind"),
    "Finding": ("devices.checking.finding", "Finding"),
    "LiveCapture": ("api.live_capture", "LiveCapture"),
    "NamedTransaction": ("devices.named_transaction", "NamedTransaction"),
    "ObservedShell": ("api.observed_shell", "ObservedShell"),
    "Outcome": ("modbus.transaction", "Outcome"),
    "PointRow": ("api.point_rows", "PointRow"),
    "PointValue": ("devices.named_transaction", "PointValue"),
    "Replay": ("api.slaves", "Replay"),
    "SerialBench": ("api.serial_bench", "SerialBench"),
    "Slave": ("api.slaves", "Slave"),
    "Trouble": ("troubles.trouble", "Trouble"),
    "WireEvent": ("core.evidence", "WireEvent"),
    "line": ("api.serial_bench", "line"),
    "open": ("api.capture", "open_capture"),
    "sniff": ("api.live_capture", "sniff"),
    **{name: ("core.errors", name) for name in _ERRORS},
}
"""For each public name: its module, relative to the package mbtool, and its name in there."""

__all__ = [
    "Capture",
    "CutError",
    "DamageError",
    "Decoder",
    "EventKind",
    "Finding",
    "InputError",
    "LinkError",
    "LiveCapture",
    "MbtoolError",
    "NamedTransaction",
    "ObservedShell",
    "Outcome",
    "OutputError",
    "PointRow",
    "PointValue",
    "ProfileError",
    "Replay",
    "SerialBench",
    "Slave",
    "Trouble",
    "UsageError",
    "WireEvent",
    "__version__",
    "line",
    "open",
    "sniff",
]


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    module, own_name = _PLACES[name]
    value: object = getattr(import_module(f"{__name__}.{module}"), own_name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
