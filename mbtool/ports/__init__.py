"""Serial ports, TCP listeners, TLS and clocks. This file exports nothing: import the modules."""
