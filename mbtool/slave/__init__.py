"""The slave that mbtool plays, in four packages: device, families, faults and shells."""
