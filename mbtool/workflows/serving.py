"""Makes a device's slave."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import SerialLink
from mbtool.modbus import Transport
from mbtool.slave import (
    DeviceResponder,
    RegisterImage,
    keep_state,
    load_image,
    open_shell,
    slave_link,
    units_on,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from mbtool.core import LinkSpec
    from mbtool.devices import Profile
    from mbtool.slave import Shell
    from mbtool.workflows.exchanges import Exchanges


def device_slave(
    profile: Profile,
    link: LinkSpec,
    unit: int = 1,
    image_file: Path | None = None,
    *,
    state_file: Path | None = None,
    allow_remote: bool = False,
    exchanges: Exchanges | None = None,
    on_trouble: Callable[[str], None] = lambda _: None,
) -> Shell:
    """A device on a link, not yet started. Raises UsageError, InputError, OutputError.

    `exchanges` are told what is asked and answered. `on_trouble` gets a line for the user where the
    state cannot be kept while it runs.
    """
    where_to_answer = slave_link(link)
    if isinstance(where_to_answer, SerialLink) and where_to_answer.ascii:
        profile = profile.in_mode(Transport.ASCII)
    image = RegisterImage.of(profile)
    if image_file is not None:
        load_image(image_file, profile, image)
    device = DeviceResponder(profile, image)
    if state_file is not None:
        keep_state(state_file, profile, device, on_trouble)
    if exchanges is not None:
        exchanges.begin(device.behaviour)
    units = units_on(where_to_answer, profile, unit, device)
    return open_shell(
        where_to_answer,
        units,
        allow_remote=allow_remote,
        rules=device.behaviour.rules,
        on_exchange=exchanges.take if exchanges is not None else None,
    )
