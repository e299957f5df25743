"""Decodes whole capture files as arrays. Needs numpy and pyarrow (the extra `columns`)."""
