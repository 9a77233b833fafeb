"""From recordings to a profile: timing, lags, noise and slopes, and how often its sets hold on what was held out."""

from fleet_cli.calibration.calibrate import Calibration, Request, calibrate
from fleet_cli.calibration.draft import Choice
from fleet_cli.calibration.profile_text import as_yaml

__all__ = ["Calibration", "Choice", "Request", "as_yaml", "calibrate"]
