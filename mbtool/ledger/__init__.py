"""One account of a capture: statistics, inventory and counts over time; without I/O and clock."""
