"""Makes a device's slave."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbtool.core import SerialLink, TcpLink, UsageError
from mbtool.core.link_spec import ANSWERED
from mbtool.slave import DeviceResponder, RegisterImage, load_image, open_shell, units_on

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
    image = RegisterImage.of(profile)
    if image_file is not None:
        load_image(image_file, profile, image)
    return open_shell(
        link,
        units_on(slave_link(link), profile, unit, DeviceResponder(profile, image)),
        allow_remote=allow_remote,
    )


def slave_link(link: LinkSpec) -> SerialLink | TcpLink:
    """The same link, if a slave can be on it. Raises UsageError."""
    if isinstance(link, SerialLink):
        link.demand_one_port()
    if isinstance(link, SerialLink | TcpLink):
        return link
    raise UsageError(f"link {link}: a slave needs {ANSWERED}")
