"""What the live views show: records come in one by one, rows go out; no I/O and no clock."""
