"""What a capture shows as a whole: statistics and inventory; no I/O, no clock."""
