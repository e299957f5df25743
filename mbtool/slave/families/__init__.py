"""What families of devices do beyond their registers. No I/O."""

from mbtool.slave.families.behaviours import make_device

__all__ = [
    "make_device",
]
