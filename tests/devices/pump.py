"""A profile that is right, for tests that make it wrong or build on it."""

PUMP = """
name = "pump"
title = "A pump"
vendor = "Maker"
transports = ["rtu"]
source = "its manual"

[functions]
03 = { limit = 16 }

[[areas]]
name = "data"
table = "holding_registers"
first = 0
last = 9
access = "rw"

[[points]]
name = "Speed"
table = "holding_registers"
address = 3
"""
