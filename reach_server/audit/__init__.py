"""Predictions held against what was measured, and the labels that follow."""
