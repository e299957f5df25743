"""Makes the simulated slaves of `mbtool slave`: one or several devices on one link."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbtool.core import LinkSpec, SerialLink, TcpLink, UsageError
from mbtool.decode.line_timing import LineTiming
from mbtool.devices import Assignment, Assignments, Profile, Who
from mbtool.modbus import Responder, Transport
from mbtool.ports.tcp_listener import THIS_MACHINE, AllowedPeers
from mbtool.slave.device import (
    Behaviour,
    DeviceResponder,
    DrivenDevice,
    RegisterImage,
    is_line,
    load_image,
    units_on,
)
from mbtool.slave.families import make_device
from mbtool.slave.shells import Shell, keep_state, open_shell, slave_link
from mbtool.workflows.shared.faults import faulty
from mbtool.workflows.shared.recorded_values import recorded_values

if TYPE_CHECKING:
    from mbtool.workflows.shared.slave_monitor import SlaveMonitor


ValuesSource = Path | Mapping[str, Any]
"""The source of register values: the path of a TOML file, or the keys and values of such a file."""


@dataclass(frozen=True, slots=True)
class Station:
    """A simulated device on a link: its profile, and the source of the initial values of its
    registers.
    """

    profile: Profile
    image_file: ValuesSource | None = None


def device_slave(
    profile: Profile,
    link: LinkSpec,
    unit: int = 1,
    image_file: ValuesSource | None = None,
    *,
    others: Mapping[int, Station] | None = None,
    state_file: Path | None = None,
    fault_file: Path | None = None,
    allowed: AllowedPeers = THIS_MACHINE,
    monitor: SlaveMonitor | None = None,
    strict_timing: bool = False,
    wrapped: Callable[[Responder], Responder] = lambda one: one,
    on_trouble: Callable[[str], None] = lambda _: None,
) -> Shell:
    """Return a shell (a TCP endpoint or serial line) with simulated devices, not yet started.

    `profile` is that of `unit`, the first device, and `image_file` gives the values of its
    registers; `others` has further devices by unit. The first device keeps its non-volatile
    registers in `state_file`, and its rules decide which TCP connections are accepted and when they
    are closed. `fault_file` describes faults to simulate. `monitor` gets each request and response.
    With `strict_timing`, a request on an RTU line whose silences are wrong gets no response.
    `wrapped` gets the responder that answers, and returns the one to use in its place. `on_trouble`
    gets a line for the user when a capture with values is incomplete, and when the state file
    cannot be written while the slave runs.

    Raises UsageError for a link, a unit or a file that does not fit the devices and for a state
    file that cannot be written, InputError for a file that cannot be read, and OutputError if the
    disk is full at the start.
    """
    stations = {unit: Station(profile, image_file), **(others or {})}
    where = _with_silences(slave_link(link), stations)
    responders: dict[int, Responder] = {}
    behaviours: dict[int, Behaviour] = {}
    for number, station in stations.items():
        device, responder = _play(station, where, on_trouble)
        _demand_unit(station.profile, device.behaviour.units, number, where)
        responders[number], behaviours[number] = responder, device.behaviour
        if number == unit and state_file is not None:
            keep_state(state_file, profile, device, on_trouble)
    if monitor is not None:
        monitor.begin(behaviours)
    slaves: Responder = units_on(where, profile, unit, responders.pop(unit), responders)
    if fault_file is not None:
        slaves = faulty(slaves, fault_file, where, [each.profile for each in stations.values()])
    return open_shell(
        where,
        wrapped(slaves),
        allowed=allowed,
        rules=behaviours[unit].rules,
        on_exchange=monitor.take if monitor is not None else None,
        strict_timing=strict_timing,
    )


def _play(
    station: Station, where: SerialLink | TcpLink, on_trouble: Callable[[str], None]
) -> tuple[DeviceResponder, Responder]:
    """Make the device of a station on the link `where`; return it, and the responder that answers
    its requests.

    The responder is the device itself, or a DrivenDevice if values change over time. `on_trouble`
    gets a line for the user about an incomplete capture with values.
    """
    profile = station.profile
    if isinstance(where, SerialLink) and where.ascii:
        profile = profile.with_limits_of(Transport.ASCII)
    image = RegisterImage.of(profile)
    driven = []
    if station.image_file is not None:
        recall = recorded_values(profile, on_trouble)
        driven = load_image(station.image_file, profile, image, recall=recall)
    device = make_device(profile, image)
    return device, DrivenDevice(device, driven) if driven else device


def _with_silences(
    where: SerialLink | TcpLink, stations: Mapping[int, Station]
) -> SerialLink | TcpLink:
    """Return the link `where`. A serial line gets the silences (t1.5, t3.5) that the profiles of
    `stations`, the devices by unit, demand.
    """
    if not isinstance(where, SerialLink):
        return where
    assigned = [Assignment(Who(unit=n), one.profile) for n, one in stations.items()]
    return replace(where, format=LineTiming(Assignments(assigned)).format_of(where))


def _demand_unit(profile: Profile, units: range, number: int, where: SerialLink | TcpLink) -> None:
    if is_line(where) and number not in units:
        raise UsageError(
            f"unit {number}: on a serial line {profile.name} can be unit {units.start} to "
            f"{units.stop - 1}"
        )
