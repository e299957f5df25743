"""The Python interface, `import mbtool`; docs/python.md describes it.

mbtool/__init__.py lists the public names and the module of each.
"""
