"""Bounds of a predicate and its derivatives over boxes, by walking its expression."""
