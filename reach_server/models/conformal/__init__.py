"""Calibrated sets: a ridge regression per horizon step, and boxes whose size is a rank statistic of its own errors."""

from reach_server.models.conformal.predictor import Boxes, ConformalPredictor, least_scores

__all__ = ["Boxes", "ConformalPredictor", "least_scores"]
