"""Compiled loops over single sets."""
