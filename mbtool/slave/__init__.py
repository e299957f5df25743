"""The slave that mbtool simulates, in four packages: device, families, faults and shells."""
