"""Speed and tightness of the hot paths, both sides of each comparison on the same work in one run."""
