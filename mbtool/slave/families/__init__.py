"""Simulated device families with functions beyond reading and writing registers. No I/O."""

from mbtool.slave.families.behaviours import make_device

__all__ = [
    "make_device",
]
