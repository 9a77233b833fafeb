#!/usr/bin/env bash
# Libraries: crepes 0.9.1, mapie 1.6.0, puncc 0.9.3 (split conformal regression).
# Expected: the same answer from each: the half-width is the residual of rank ceil((n + 1) * confidence), counted
#   from the smallest, and infinite when that is above n. With n = 9 residuals at 90 % that is rank 9; with n = 19,
#   rank 18.
# Happens: with n = 9, crepes answers with an infinite interval, mapie refuses by default and puncc gives rank 9.
#   With n = 19 crepes gives rank 19, the others 18: it takes int((1 - confidence) * (n + 1)), and 1 - 0.9 is a
#   little below 0.1 (for the same reason puncc refuses n = 9 when alpha is written as 1 - 0.9). At 50 % all agree.
#   The docstrings of the three calls name no rank; crepes only says that "too high" a level gives the maximum size.
# Matters: n + 1 = 10, 20, 100 are the sizes that people choose, because the rank comes out whole. A coverage table
#   made with one library does not hold with another. Compute the rank in rational numbers and take the residual
#   yourself.
set -euo pipefail
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
python3 -m venv "$tmp/venv"
"$tmp/venv/bin/pip" install --quiet --quiet --no-compile --disable-pip-version-check \
    crepes==0.9.1 mapie==1.6.0 puncc==0.9.3 numpy==1.26.4 scipy==1.17.1 scikit-learn==1.9.1 pandas==3.0.6
"$tmp/venv/bin/python" - <<'PYTHON'
import math
import sys
import warnings
from fractions import Fraction
from importlib.metadata import version

import numpy as np
from crepes import ConformalRegressor
from deel.puncc.api.prediction import BasePredictor
from deel.puncc.regression import SplitCP
from mapie.regression import SplitConformalRegressor
from sklearn.base import BaseEstimator, RegressorMixin


class Zero(RegressorMixin, BaseEstimator):
    """Predicts 0, so that a residual is the value itself."""

    def fit(self, x, y):
        self.fitted_ = True
        return self

    def predict(self, x):
        return np.zeros(len(x))


def by_crepes(residuals: np.ndarray, confidence: float) -> float:
    regressor = ConformalRegressor()
    regressor.fit(residuals=residuals)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns where the interval is infinite
        return float(regressor.predict_int(np.zeros(1), confidence=confidence)[0, 1])


def by_mapie(residuals: np.ndarray, confidence: float) -> float | str:
    x = np.zeros((len(residuals), 1))
    regressor = SplitConformalRegressor(Zero().fit(x, residuals), confidence_level=confidence, prefit=True)
    try:
        regressor.conformalize(x, residuals)
        return float(np.ravel(regressor.predict_interval(x[:1])[1])[1])
    except ValueError:
        return "refused"


def by_puncc(residuals: np.ndarray, confidence: float) -> float:
    alpha = float(1 - Fraction(str(confidence)))  # 0.1 as one writes it; 1 - 0.9 is less, and refused for n = 9
    x = np.zeros((len(residuals), 1))
    regressor = SplitCP(BasePredictor(Zero().fit(x, residuals), is_trained=True), train=False)
    regressor.fit(X_fit=x[:1], y_fit=residuals[:1], X_calib=x, y_calib=residuals)
    return float(np.ravel(regressor.predict(x[:1], alpha=alpha)[2])[0])


def right(n: int, confidence: float) -> float:
    rank = math.ceil((n + 1) * Fraction(str(confidence)))
    return float(rank) if rank <= n else math.inf


print(*(f"{name} {version(name)}" for name in ("crepes", "mapie", "puncc")), "(residuals are 1, 2, ..., n)")
found = {}
for n, confidence in ((9, 0.9), (19, 0.9), (19, 0.5)):
    residuals = np.arange(1.0, n + 1)
    answers = tuple(by(residuals, confidence) for by in (by_crepes, by_mapie, by_puncc))
    found[n, confidence] = (*answers, right(n, confidence))
    crepes, mapie, puncc = answers
    print(f"n = {n}, {confidence:.0%}: crepes {crepes}, mapie {mapie}, puncc {puncc}; rank {right(n, confidence)}")
if found[19, 0.5] != (10.0, 10.0, 10.0, 10.0):
    sys.exit("changed: the three no longer agree at 50 %")
if found[9, 0.9] != (math.inf, "refused", 9.0, 9.0) or found[19, 0.9] != (19.0, 18.0, 18.0, 18.0):
    sys.exit("changed: the answers at 90 % are others now")
PYTHON
