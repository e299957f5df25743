"""Capture, decode and replay Modbus."""

__version__ = "0.1.0"
