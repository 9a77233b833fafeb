"""From samples to regressors: windows, continuity of samples, and observed ranges."""
