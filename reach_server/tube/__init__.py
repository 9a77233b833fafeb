"""Propagation of sets over the horizon, with and without branches."""
