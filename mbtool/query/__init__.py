"""Implements the --where language, in which a user writes filters for transactions."""
