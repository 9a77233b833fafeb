"""Models learned from data, and bounds that hold without data."""
