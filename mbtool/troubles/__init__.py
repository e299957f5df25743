"""Judges what is wrong, why, and what to do: one judgement for all commands."""
