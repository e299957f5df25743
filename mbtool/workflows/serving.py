"""Makes a device's slave."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.slave import (
    DeviceResponder,
    RegisterImage,
    load_image,
    open_shell,
    slave_link,
    units_on,
)

if TYPE_CHECKING:
    from pathlib import Path

    from mbtool.core import LinkSpec
    from mbtool.devices import Profile
    from mbtool.slave import Shell


def device_slave(
    profile: Profile,
    link: LinkSpec,
    unit: int = 1,
    image_file: Path | None = None,
    *,
    allow_remote: bool = False,
) -> Shell:
    """A device on a link, not yet started. Raises UsageError, InputError."""
    where_to_answer = slave_link(link)
    image = RegisterImage.of(profile)
    if image_file is not None:
        load_image(image_file, profile, image)
    units = units_on(where_to_answer, profile, unit, DeviceResponder(profile, image))
    return open_shell(where_to_answer, units, allow_remote=allow_remote)
