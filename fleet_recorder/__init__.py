"""Recordings of the bus: written as MCAP files, read, played again, and cut."""
