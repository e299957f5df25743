"""Sums up a whole capture: statistics and inventory; no I/O, no clock."""
