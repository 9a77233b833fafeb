"""What a side-info service tells Prometheus."""

from fleet_bus.codec import REASONS
from side_info.service import watching
from side_info.service.metrics import metrics
from tests.scrapes import side_info_text, values


def test_it_says_what_its_status_says() -> None:
    found = values(side_info_text())
    assert found["fleet_side_info_scenarios", ()] == 1
    assert found["fleet_side_info_documents_published_total", ()] == 1
    assert found["fleet_side_info_vehicles", ()] == 0
    # By its clock, which began there.
    assert 0 <= found["fleet_side_info_status_timestamp_seconds", ()] - 10**9 <= 2
    reasons = {dict(labels)["reason"] for name, labels in found if name == "fleet_refused_total"}
    assert reasons == {*REASONS, *watching.REASONS}


def test_before_the_first_status_it_says_nothing() -> None:
    assert list(metrics(lambda: None)) == []
