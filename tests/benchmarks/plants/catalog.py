"""All plants by name."""

from __future__ import annotations

from random import Random
from typing import TYPE_CHECKING

from tests.benchmarks.plants import (
    disturbed_plants,
    heard_plants,
    odd_plants,
    polling_plants,
    silent_plants,
)
from tests.benchmarks.plants.site import Site

if TYPE_CHECKING:
    from collections.abc import Callable

    from mbtool.core import SerialFormat
    from tests.benchmarks.plants.recording import Recording

    Plant = Callable[[Site, int], None]


def mixed(site: Site, requests: int) -> None:
    """All in turn on one line: polls, writes, dead units, scans, user-defined functions, noise."""
    while site.asked < requests:
        part = site.random.choice((
            polling_plants.clean, polling_plants.clean, polling_plants.write_loop,
            polling_plants.register_scan, polling_plants.user_defined, silent_plants.dead_units,
            silent_plants.lost_responses, silent_plants.unit_scan, disturbed_plants.stray_bytes,
            disturbed_plants.noise_bursts,
        ))  # fmt: skip
        part(site, min(requests, site.asked + site.random.randint(5, 40)))


PLANTS: dict[str, Plant] = {
    "clean": polling_plants.clean,
    "stray bytes": disturbed_plants.stray_bytes,
    "dead units": silent_plants.dead_units,
    "lost responses": silent_plants.lost_responses,
    "write loop": polling_plants.write_loop,
    "slow writes": polling_plants.slow_writes,
    "near timeout": silent_plants.near_timeout,
    "late responses": silent_plants.late_responses,
    "unit scan": silent_plants.unit_scan,
    "register scan": polling_plants.register_scan,
    "adapter echo": disturbed_plants.adapter_echo,
    "two masters": disturbed_plants.two_masters,
    "noise bursts": disturbed_plants.noise_bursts,
    "glued": polling_plants.glued,
    "user-defined": polling_plants.user_defined,
    "mixed": mixed,
    "radio gaps": odd_plants.radio_gaps,
    "slow slave": odd_plants.slow_slave,
    "slave of two": odd_plants.slave_of_two,
    "set points": odd_plants.set_points,
    "odd devices": odd_plants.odd_devices,
    "only one wire": heard_plants.only_one_wire,
    "repeater": heard_plants.repeater,
    "lost bytes": heard_plants.lost_bytes,
    "bias": heard_plants.bias,
    "baud change": heard_plants.baud_change,
    "foreign protocol": heard_plants.foreign_protocol,
}


def record(plant: str, seed: int, requests: int, line: SerialFormat | None = None) -> Recording:
    """What was on a line, the same for the same arguments."""
    site = Site(Random(f"{plant} {seed}"), line)
    PLANTS[plant](site, requests)
    return site.bus.recording
