"""Where bytes come from: files, serial ports, interfaces and taps.

Callers import from the modules, as each module loads only what it needs.
"""
