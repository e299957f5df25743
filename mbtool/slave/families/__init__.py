"""Device families that do more than read and write registers. No I/O."""

from mbtool.slave.families.behaviours import make_device

__all__ = [
    "make_device",
]
