"""From samples to regressors: windows, what may follow what, and what the data shows."""
