"""The version of mbtool.

This file is the only place that has it; the package reads it from here.
"""

__version__ = "0.2.0"
