"""The side-info process publishes what its operator changes in a scenario file, and keeps what it refuses."""

import queue
from pathlib import Path

import pytest

from fleet_bus import keys
from fleet_bus.messages import ScenarioDocument, ServiceStatus
from fleet_bus.pubsub import Received, declare_recovering_subscriber
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.integration.conftest import Start
from tests.side_info.corpus import DOCUMENT
from tests.waiting import DEADLINE

pytestmark = pytest.mark.integration

SECOND = DOCUMENT.replace("version: 1", "version: 2")


def test_a_changed_file_is_published_by_the_running_process(tmp_path: Path, router: Router, start: Start) -> None:
    path = tmp_path / "lot.yaml"
    path.write_text(DOCUMENT, encoding="utf-8")
    documents: queue.Queue[Received] = queue.Queue()
    statuses: queue.Queue[Received] = queue.Queue()

    def next_document() -> ScenarioDocument:
        received = documents.get(timeout=DEADLINE)
        return ScenarioDocument.decode(received.payload, received.encoding)

    with (
        open_session(Role.VIEWER, router.endpoints) as session,
        declare_recovering_subscriber(session, keys.ALL_DOCUMENTS, documents.put, history=1, late_publishers=True),
        declare_recovering_subscriber(
            session, keys.service_status("side-info", "side-info-1"), statuses.put, history=1, late_publishers=True
        ),
    ):
        process = start("side-info", str(path), "--router", router.endpoints[0])
        process.expect("side-info publishes lot")
        assert next_document() == ScenarioDocument(scenario="lot", version=1, text=DOCUMENT)
        path.write_text(SECOND, encoding="utf-8")
        assert next_document() == ScenarioDocument(scenario="lot", version=2, text=SECOND)
        path.write_text(SECOND.replace("version: 2", "version: 3").replace("](P) and", "](Q) and"), encoding="utf-8")
        process.expect("document refused")
        process.expect("'Q' is not declared")
        refused: dict[str, int] = {}
        while not refused:
            refused = ServiceStatus.decode(statuses.get(timeout=DEADLINE).payload).refused
        assert refused == {"document_invalid": 1}
        (reply,) = [reply.ok for reply in session.get(keys.document("lot"), timeout=DEADLINE)]
        assert reply is not None
        assert ScenarioDocument.decode(reply.payload.to_bytes(), str(reply.encoding)).version == 2
    assert process.end() == 0
