"""Real recordings, through a router, become tubes."""

import numpy as np
import pytest

from fleet_bus import Role, keys, open_session
from fleet_bus.messages import ReachTube
from fleet_bus.pubsub import subscribe
from fleet_bus.router import Router
from tests.integration.conftest import RECORDINGS, Start, run_fleet
from tests.waiting import wait_until

pytestmark = pytest.mark.integration


@pytest.mark.parametrize(
    ("recording", "profile", "speed"),
    [("fix_f1tenth_koopman", "f1tenth", 20), ("fix_dart_free", "dart", 6), ("fix_upenn_pf", "upenn", 12)],
)
def test_each_recording_gives_tubes(recording: str, profile: str, speed: int, router: Router, start: Start) -> None:
    endpoint = router.endpoints[0]
    start("reach", "--router", endpoint).expect("ready")
    tubes: list[ReachTube] = []
    with open_session(Role.VIEWER, [endpoint]) as session:
        with subscribe(session, keys.ALL_TUBES, lambda r: tubes.append(ReachTube.decode(r.payload, r.encoding))):
            replay = start(
                "replay", str(RECORDINGS / f"{recording}.npz"), "--profile", profile, "--speed", str(speed),
                "--as", "car", "--router", endpoint,
            )  # fmt: skip
            wait_until(lambda: len(tubes) >= 20)
            replay.end()
    for tube in tubes:
        assert tube.vehicle == "car"
        # What lies outside of the data of the first samples is claimed of no set, and said.
        outside = any(note.startswith("outside the data") for note in tube.notes)
        assert tube.label == ("uncovered" if outside else "calibrated")
        assert tube.center.shape == (10, 4)
        assert (tube.area > 0).all()
        assert np.isfinite(tube.outline).all()
        assert len(tube.encode()) <= 3072 + sum(len(note) + 2 for note in tube.notes)


def test_a_missing_recording_is_named() -> None:
    done = run_fleet("replay", "nowhere.npz", "--profile", "f1tenth")
    assert done.returncode == 2
    assert "nowhere.npz" in done.stderr
