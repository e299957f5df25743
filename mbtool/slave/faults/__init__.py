"""Faults that a slave simulates, to test masters. No I/O."""
