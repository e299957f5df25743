"""Decodes capture files many packets at a time, with their headers and fields in numpy arrays.
Needs numpy and pyarrow (the extra `columns`).
"""
