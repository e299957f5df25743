"""Collects values over time in bounded memory; does no I/O and reads no clock."""
