"""A master that asks slaves: links and polls."""
