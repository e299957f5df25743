"""Decodes evidence into transactions: protocol detection, framing, pairing. No I/O."""
