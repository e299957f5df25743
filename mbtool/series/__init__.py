"""What happened when: counts and values over time in bounded memory; no I/O, no clock."""
