"""The version of mbtool. It stands here only: the package takes it from this file."""

__version__ = "0.2.0"
