"""Recordings of the bus: written as MCAP files, read, played again, cut, and proven to give the same tubes."""
