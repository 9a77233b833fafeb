"""What the tests of the paper's study share: one simulated study, and its blocks."""

import numpy as np
import pytest

from fleet_lab.paper import models
from fleet_lab.paper.cells import Block, Drive
from fleet_lab.paper.formulas import FORMULAS
from fleet_lab.paper.study import Study

#: In every phase of the formulas, and at the ends of windows; seconds.
MOMENTS = {
    "phi_p": (0.01, 1.0, 7.3, 12.9, 19.0, 23.99, 24.0, 24.4, 25.0, 25.01, 28.0, 33.3, 40.0),
    "phi_theta": (0.01, 3.1, 16.2, 23.99, 24.0, 24.7, 25.0, 25.01, 31.0, 40.0),
    "phi_r": (0.01, 2.2, 3.99, 4.0, 4.01, 5.0, 6.6, 8.1, 9.5, 9.99, 10.0, 10.01, 12.0, 14.0),
}


@pytest.fixture(scope="session")
def study() -> Study:
    return Study(0)


@pytest.fixture(scope="session")
def blocks(study: Study) -> dict[str, Block]:
    """Every block by key but that of the reach server, which takes a minute."""
    parts = (
        study.printed, study.published_code, study.printed_text, study.ours, study.ours_with_noise,
        study.demonstrations, study.routes,
    )  # fmt: skip
    found = [part(lambda part: None) for part in parts]
    return {block.key: block for block in found}


@pytest.fixture(scope="session")
def drives(study: Study) -> dict[str, Drive]:
    """The steps of one drive of each formula at ``MOMENTS``."""
    found = {}
    for formula in FORMULAS:
        drive = study.drives(formula, models.as_published_code)[0]
        found[formula.key] = drive.take(
            np.isin(np.round(100 * drive.at.t), np.round(100 * np.array(MOMENTS[formula.key])))
        )
        assert len(found[formula.key].truth) == len(MOMENTS[formula.key])
    return found
