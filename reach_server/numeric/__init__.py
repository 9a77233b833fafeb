"""Arrays with no idea of vehicles: types, checks, intervals, compiled code and its cache."""
