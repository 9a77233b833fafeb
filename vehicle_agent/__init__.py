"""The edge process: a source of readings, a filter, and the loop that publishes them on the bus."""
