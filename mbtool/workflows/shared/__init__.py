"""Code that several workflows share."""
