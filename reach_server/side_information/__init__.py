"""Scenarios along a drive: what signal temporal logic still asks of each vehicle."""
