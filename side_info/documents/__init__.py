"""Scenario documents: reading, checking, and what is wrong where."""
