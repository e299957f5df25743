"""What `import mbtool` gives: docs/python.md. Its names are listed in mbtool/__init__.py."""
