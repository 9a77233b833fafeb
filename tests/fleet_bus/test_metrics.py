"""The endpoint: where it listens, what it survives, and that nothing of it is left."""

import socket
import threading
import urllib.error
from collections.abc import Iterator

import pytest
from prometheus_client.metrics_core import Metric

from fleet_bus import metrics
from fleet_bus.errors import SessionError, UsageError
from fleet_bus.histogram import Histogram
from tests.scrapes import fetch, scrape, values
from tests.waiting import wait_until


def nothing() -> list[Metric]:
    return []


def connect(url: str) -> socket.socket:
    host, _, port = url.removeprefix("http://").partition("/")[0].rpartition(":")
    return socket.create_connection((host, int(port)), timeout=60)


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("9471", ("127.0.0.1", 9471)),
        ("0", ("127.0.0.1", 0)),
        ("0.0.0.0:9471", ("0.0.0.0", 9471)),
        ("reach.lab:80", ("reach.lab", 80)),
        ("[::1]:9471", ("::1", 9471)),
    ],
)
def test_addresses(text: str, address: tuple[str, int]) -> None:
    assert metrics.parse_address(text) == address


@pytest.mark.parametrize("text", ["", ":", "x", "65536", "-1", "localhost", "localhost:", ":9471", "1.5", "²", "[]:1"])
def test_what_is_no_address_is_said_so(text: str) -> None:
    with pytest.raises(UsageError, match=r"expected \[HOST:\]PORT"):
        metrics.parse_address(text)


def test_it_answers_this_machine_alone_on_a_free_port_and_leaves_nothing() -> None:
    before = threading.active_count()
    with metrics.serve(metrics.registry("reach", "one", nothing), "0") as url:
        assert url.startswith("http://127.0.0.1:")
        found = values(fetch(url))
    names = {name for name, _ in found}
    assert {"process_cpu_seconds_total", "process_resident_memory_bytes", "python_info"} <= names
    ((_, labels),) = [key for key in found if key[0] == "fleet_service_info"]
    assert dict(labels).items() >= {"kind": "reach", "id": "one"}.items()
    with pytest.raises(ConnectionRefusedError):
        connect(url)
    wait_until(lambda: threading.active_count() == before)


def test_a_port_in_use_is_said_so() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SessionError, match=rf"cannot listen on 127.0.0.1 port {port}: .*in use.*choose another"):
            with metrics.serve(metrics.registry("reach", "one", nothing), str(port)):
                pass


def test_a_host_that_is_not_there_is_said_so() -> None:
    # Of a network that is kept for documentation.
    with pytest.raises(SessionError, match=r"cannot listen on 192\.0\.2\.1"):
        with metrics.serve(metrics.registry("reach", "one", nothing), "192.0.2.1:0"):
            pass


def test_a_port_can_be_taken_again_at_once() -> None:
    with metrics.serve(metrics.registry("reach", "one", nothing), "0") as url:
        fetch(url)
    port = url.rpartition(":")[2].partition("/")[0]
    with metrics.serve(metrics.registry("reach", "one", nothing), port) as again:
        assert fetch(again)


def test_clients_that_say_nothing_delay_neither_others_nor_the_end() -> None:
    with metrics.serve(metrics.registry("reach", "one", nothing), "0") as url:
        silent = [connect(url) for _ in range(metrics.MOST_CLIENTS // 2)]
        assert "fleet_service_info" in fetch(url)
    for client in silent:
        # They were hung up on.
        assert client.recv(1) == b""
        client.close()


def test_too_many_clients_are_hung_up_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics, "MOST_CLIENTS", 1)
    with metrics.serve(metrics.registry("reach", "one", nothing), "0") as url:
        with connect(url) as silent:
            silent.sendall(b"GET")
            with connect(url) as other:
                # Nothing was sent that could be lost by the hang-up.
                assert other.recv(1) == b""


def test_a_client_that_hangs_up_is_no_fault(capfd: pytest.CaptureFixture[str]) -> None:
    with metrics.serve(metrics.registry("reach", "one", nothing), "0") as url:
        with connect(url) as client:
            client.sendall(b"\x00\xffnonsense\r\n\r\n")
        assert fetch(url)
    assert "Traceback" not in capfd.readouterr().err


def test_what_cannot_be_read_is_an_error_to_the_client_and_the_next_answer_is_right() -> None:
    broken = threading.Event()
    broken.set()

    def read() -> Iterator[Metric]:
        if broken.is_set():
            raise RuntimeError("injected")
        yield metrics.gauge("fleet_x", "X.", 1)

    with metrics.serve(metrics.registry("reach", "one", read), "0") as url:
        with pytest.raises(urllib.error.HTTPError) as failed:
            fetch(url)
        failed.value.close()
        assert failed.value.code == 500
        broken.clear()
        assert values(fetch(url))["fleet_x", ()] == 1.0


def test_families_are_what_they_say() -> None:
    counted = Histogram((0.5, 2.0))
    counted.add([0.1, 1.0, 3.0])

    def read() -> Iterator[Metric]:
        yield metrics.counter("fleet_a", "A.", {("x", "y"): 2}, "one", "two")
        yield metrics.gauge("fleet_b", "B.", 3.5)
        yield metrics.histogram("fleet_c_seconds", "C.", counted)
        yield metrics.refusals({"range": 2, "new": 1}, ["range", "shape"])

    found = values(scrape("reach", read))
    assert found["fleet_a_total", (("one", "x"), ("two", "y"))] == 2
    assert found["fleet_b", ()] == 3.5
    buckets = {dict(labels)["le"]: value for (name, labels), value in found.items() if name == "fleet_c_seconds_bucket"}
    assert buckets == {"0.5": 1, "2": 2, "+Inf": 3}
    assert found["fleet_c_seconds_count", ()] == 3
    assert found["fleet_c_seconds_sum", ()] == pytest.approx(4.1)
    reasons = {
        dict(labels)["reason"]: value for (name, labels), value in found.items() if name == "fleet_refused_total"
    }
    assert reasons == {"range": 2, "shape": 0, "new": 1}
