"""Turns records into the rows of live views; does no I/O and reads no clock."""
