"""The embedded slave. Its rooms: device, families, faults and shells."""
