"""Scenarios along a drive: what signal temporal logic still asks of each vehicle."""

from reach_server.side_information.drive_check import first_contradiction

__all__ = ["first_contradiction"]
