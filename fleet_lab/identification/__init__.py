"""From recordings to a profile: timing, lags, noise and slopes, and how often its sets hold on what was held out."""

from fleet_lab.identification.calibrate import Calibration, CalibrationError, calibrate
from fleet_lab.identification.draft import Choice
from fleet_lab.identification.held_out import Request
from fleet_lab.identification.profile_text import as_yaml, draft_as_yaml

__all__ = ["Calibration", "CalibrationError", "Choice", "Request", "as_yaml", "calibrate", "draft_as_yaml"]
