"""Finds what is wrong, why, and what to do: one list of troubles for all commands."""
