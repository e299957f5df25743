"""A master: sends requests to slaves and receives their responses."""
