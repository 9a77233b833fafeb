"""Checks of predictions against measurements, and the labels that follow."""
