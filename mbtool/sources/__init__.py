"""Sources of captured bytes: files, serial ports, network interfaces and taps.

This file exports nothing: import the module you need, as each loads only what it needs.
"""
