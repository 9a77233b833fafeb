"""A Prometheus endpoint: what a service counts, read when it is asked for, over plain HTTP.

The HTTP server is that of the standard library, in threads of its own. Only who is asked for an endpoint imports this.
"""

import socket
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from socketserver import TCPServer, ThreadingMixIn
from threading import Lock, Thread
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

import structlog
from prometheus_client import CollectorRegistry, GCCollector, PlatformCollector, ProcessCollector, make_wsgi_app
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from fleet_bus.errors import SessionError, UsageError
from fleet_bus.histogram import Histogram

_log = structlog.get_logger(__name__)

LOOPBACK: Final = "127.0.0.1"
#: Seconds that a client may take for each part of its request, and clients that are answered at once.
PATIENCE: Final = 5.0
MOST_CLIENTS: Final = 16

#: A number, or a number by the value of each label.
Values = float | Mapping[Any, float]


def counter(name: str, text: str, values: Values, *labels: str) -> Metric:
    """What only grows, called ``name_total``; by ``labels`` where ``values`` is a map of their values."""
    return _filled(CounterMetricFamily(name, text, labels=labels or None), values)


def gauge(name: str, text: str, values: Values, *labels: str) -> Metric:
    """What grows and falls; by ``labels`` where ``values`` is a map of their values."""
    return _filled(GaugeMetricFamily(name, text, labels=labels or None), values)


def histogram(name: str, text: str, counted: Histogram) -> Metric:
    """How often values of which size came."""
    counts, total = counted.read()
    bounds = [*(f"{bound:g}" for bound in counted.bounds), "+Inf"]
    return HistogramMetricFamily(name, text, buckets=list(zip(bounds, counts, strict=True)), sum_value=total)


def refusals(by_reason: Mapping[str, int], known: Iterable[str]) -> Metric:
    """Messages that a service refused; reasons that are ``known`` are there before the first refusal, since an increase
    from nothing is none to Prometheus."""
    counts = {**dict.fromkeys(known, 0), **by_reason}
    return counter("fleet_refused", "Messages refused, by reason.", counts, "reason")


def _filled(family: CounterMetricFamily | GaugeMetricFamily, values: Values) -> Metric:
    for key, value in values.items() if isinstance(values, Mapping) else [((), values)]:
        family.add_metric([str(part) for part in (key if isinstance(key, tuple) else (key,))], value)
    return family


class _Read(Collector):
    def __init__(self, read: Callable[[], Iterable[Metric]]) -> None:
        self._read = read

    def collect(self) -> Iterable[Metric]:
        """What there is to say now."""
        return self._read()


def registry(kind: str, instance: str, read: Callable[[], Iterable[Metric]]) -> CollectorRegistry:
    """What ``read`` gives when it is asked, on a thread of the endpoint; with the name of the service, and what is
    known of its process."""
    made = CollectorRegistry()
    for collector in (ProcessCollector, PlatformCollector, GCCollector):
        collector(registry=made)
    try:
        release = version("fleet-reach")
    except PackageNotFoundError:
        release = "unknown"
    told = gauge(
        "fleet_service_info", "One; which service this is.", {(kind, instance, release): 1.0}, "kind", "id", "version"
    )
    made.register(_Read(lambda: (told, *read())))
    return made


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of ``[HOST:]PORT``; the host is that of this machine alone where none is named. Raises
    ``UsageError`` for anything else."""
    host, colon, number = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") if colon else LOOPBACK
    if not (number.isascii() and number.isdecimal() and int(number) < 2**16 and host):
        raise UsageError(
            f"--metrics {text!r:.80}: expected [HOST:]PORT, such as 9471 or 0.0.0.0:9471; 0 is a free port"
        )
    return host, int(number)


@contextmanager
def serve(registry: CollectorRegistry, address: str) -> Iterator[str]:
    """Answer at ``address``, ``[HOST:]PORT``, until the end of the block; yields the URL.

    Raises ``UsageError`` for an address that is none, ``SessionError`` if nothing can listen there.
    """
    host, port = parse_address(address)
    try:
        server = _Server(host, port, make_wsgi_app(registry))
    except OSError as error:
        why = error.strerror or str(error)
        raise SessionError(
            f"--metrics {address}: cannot listen on {host} port {port}: {why}; choose another port, or 0 for a free one"
        ) from None
    thread = Thread(target=server.serve_forever, args=(0.1,), name="metrics", daemon=True)
    thread.start()
    shown = f"[{host}]" if ":" in host else host
    try:
        yield f"http://{shown}:{server.server_address[1]}/metrics"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class _Handler(WSGIRequestHandler):
    timeout = PATIENCE

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing of requests."""


class _Server(ThreadingMixIn, WSGIServer):
    """A thread a request; ``server_close`` cuts off those that still go on and waits for their threads."""

    daemon_threads = False

    def __init__(self, host: str, port: int, app: Callable[..., Sequence[bytes]]) -> None:
        (self.address_family, *_, address) = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        self._lock = Lock()
        self._connections: set[socket.socket] = set()
        self._app = app
        super().__init__((str(address[0]), port), _Handler)
        self.set_app(self._answer)

    def server_bind(self) -> None:
        """Bind without asking for the name of the host, which may take long."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = self.server_address[:2]  # type: ignore[assignment]
        self.setup_environ()

    def _answer(self, environ: dict[str, Any], start_response: Any) -> Sequence[bytes]:
        try:
            return self._app(environ, start_response)
        except Exception:
            _log.exception("metrics could not be read")
            start_response("500 Internal Server Error", [("Content-Type", "text/plain")])
            return [b"the metrics could not be read, the log of the service says why\n"]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer on a thread, or hang up where too many are being answered."""
        with self._lock:
            crowded = len(self._connections) >= MOST_CLIENTS
            if not crowded:
                self._connections.add(request)
        if crowded:
            self.shutdown_request(request)
        else:
            super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock:
            self._connections.discard(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Who hangs up, or takes too long, is nothing to report."""
        _log.debug("a client of the metrics went away", client=str(client_address)[:80], exc_info=True)

    def server_close(self) -> None:
        """Stop listening, and end what goes on."""
        with self._lock:
            for connection in self._connections:
                try:
                    connection.shutdown(socket.SHUT_RDWR)
                except OSError:
                    # It has gone already.
                    continue
        super().server_close()
