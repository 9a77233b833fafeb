"""Sets over the horizon, with and without branches."""
