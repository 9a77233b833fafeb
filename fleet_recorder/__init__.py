"""Recordings of the bus: written, replayed, and proven to give the same tubes."""
