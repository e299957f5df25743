"""Parts of the workflows that several commands use."""
