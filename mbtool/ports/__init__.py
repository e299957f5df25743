"""Serial ports, TCP listeners, TLS and clocks. Callers import from the modules."""
