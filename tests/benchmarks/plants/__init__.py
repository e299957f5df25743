"""RS-485 lines with exact truth, made from the specification and from practice."""
