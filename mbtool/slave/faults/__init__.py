"""Faults that a slave shows on purpose. No I/O."""
