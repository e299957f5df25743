"""Where bytes come from. Callers import from the modules: each loads only what it needs."""
