"""Summarises a whole capture as statistics and as an inventory; without I/O and clock."""
