"""Calibrated sets: a ridge regression per horizon step, and boxes whose size is a rank statistic of its own errors."""

from reach_server.calibrated.learner import Boxes, Calibrated, least_scores

__all__ = ["Boxes", "Calibrated", "least_scores"]
