"""The --where language: filters over transactions."""
