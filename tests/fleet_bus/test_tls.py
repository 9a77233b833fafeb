"""A certificate that is refused, on either side, is told from a router that is not there."""

import json
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from fleet_bus import tls
from fleet_bus.errors import SessionError
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session, why_not_connected
from tests.certificates import Pair, authority, issue, needs_openssl
from tests.waiting import wait_until

pytestmark = [pytest.mark.integration, needs_openssl]

HERE = "DNS:localhost,IP:127.0.0.1"


@dataclass(frozen=True)
class Made:
    ca: Pair
    other_ca: Pair
    router: Pair
    elsewhere: Pair
    old: Pair
    car: Pair
    old_car: Pair
    foreign_car: Pair


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("certificates")
    ca, other = authority(folder, "ca"), authority(folder, "other-ca")
    return Made(
        ca,
        other,
        issue(folder, "router", ca, HERE),
        issue(folder, "elsewhere", ca, "DNS:router.example.org"),
        issue(folder, "old", ca, HERE, days=-1),
        issue(folder, "car", ca, "DNS:car"),
        issue(folder, "old-car", ca, "DNS:car", days=-1),
        issue(folder, "foreign-car", other, "DNS:car"),
    )


@contextmanager
def routing(made: Made, shown: Pair, folder: Path) -> Iterator[str]:
    """A router that asks for certificates; its endpoint without parameters."""
    settings = {
        "root_ca_certificate": str(made.ca.certificate),
        "listen_certificate": str(shown.certificate),
        "listen_private_key": str(shown.key),
        "enable_mtls": True,
    }
    file = folder / "router.json"
    file.write_text(json.dumps({"transport": {"link": {"tls": settings}}}), encoding="utf-8")
    with Router(["tls/127.0.0.1:0"], config_file=file) as router:
        yield router.endpoints[0]


def parameters(ca: Pair | None, own: Pair | None, **more: str) -> str:
    words = {} if ca is None else {"root_ca_certificate_file": str(ca.certificate)}
    if own is not None:
        words |= {"connect_certificate_file": str(own.certificate), "connect_private_key_file": str(own.key)}
        words |= {"enable_mtls": "true"}
    return ";".join(f"{name}={value}" for name, value in (words | more).items())


def test_with_the_right_certificates_it_connects(made: Made, tmp_path: Path) -> None:
    with routing(made, made.router, tmp_path) as bare:
        endpoint = f"{bare}#{parameters(made.ca, made.car)}"
        assert tls.failure(endpoint) is None
        with open_session(Role.SERVICE, [endpoint]) as session:
            assert list(session.info.routers_zid())


Choose = Callable[[Made], tuple[Pair, str]]


@pytest.mark.parametrize(
    ("choose", "said"),
    [
        pytest.param(lambda m: (m.router, parameters(m.other_ca, m.car)), "is not by the CA in", id="another CA"),
        pytest.param(lambda m: (m.router, ""), "name the CA's file", id="no CA named"),
        pytest.param(lambda m: (m.elsewhere, parameters(m.ca, m.car)), "is not for '127.0.0.1'", id="another name"),
        pytest.param(lambda m: (m.old, parameters(m.ca, m.car)), "its certificate has expired", id="expired"),
        pytest.param(lambda m: (m.router, parameters(m.ca, None)), "none was shown", id="no certificate"),
        pytest.param(
            lambda m: (m.router, parameters(m.ca, m.car, enable_mtls="false")), "enable_mtls=true only", id="not shown"
        ),
        pytest.param(lambda m: (m.router, parameters(m.ca, m.old_car)), "shown has expired", id="own expired"),
        pytest.param(
            lambda m: (m.router, parameters(m.ca, m.foreign_car)), "does not know the CA", id="own by another CA"
        ),
    ],
)
@pytest.mark.parametrize("role", [Role.SERVICE, Role.AGENT])
def test_what_is_refused_is_told(role: Role, choose: Choose, said: str, made: Made, tmp_path: Path) -> None:
    shown, words = choose(made)
    with routing(made, shown, tmp_path) as bare:
        endpoint = f"{bare}#{words}" if words else bare
        if role is Role.AGENT:
            with open_session(role, [endpoint]) as session:
                message = str(why_not_connected(session, [endpoint]))
        else:
            with pytest.raises(SessionError) as refused:
                open_session(role, [endpoint], timeout=0.1)
            message = str(refused.value)
    assert f"{bare} answers, but TLS fails" in message
    assert said in message
    assert "no router answers" not in message


def test_where_nobody_listens_no_router_answers(made: Made) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tls/127.0.0.1:{probe.getsockname()[1]}#{parameters(made.ca, made.car)}"
    with pytest.raises(SessionError, match="no router answers"):
        open_session(Role.SERVICE, [endpoint], timeout=0.1)


def test_a_router_without_tls_is_told(made: Made) -> None:
    with Router(["tcp/127.0.0.1:0"]) as router:
        endpoint = router.endpoints[0].replace("tcp/", "tls/") + "#" + parameters(made.ca, made.car)
        with pytest.raises(SessionError, match=r"answers, but TLS fails: .*does a router listen for TLS there"):
            open_session(Role.SERVICE, [endpoint], timeout=0.1)


def test_one_router_of_several_is_enough(made: Made, tmp_path: Path) -> None:
    with routing(made, made.old, tmp_path) as refused, Router(["tcp/127.0.0.1:0"]) as router:
        routers = [f"{refused}#{parameters(made.ca, made.car)}", *router.endpoints]
        with open_session(Role.SERVICE, routers) as session:
            assert list(session.info.routers_zid())


@pytest.mark.parametrize("role", list(Role))
@pytest.mark.parametrize(
    ("choose", "said"),
    [
        (lambda m, absent: parameters(Pair(absent, absent), m.car), "cannot be read"),
        (lambda m, absent: parameters(Pair(m.ca.key, m.ca.key), m.car), "holds no certificate"),
        (lambda m, absent: parameters(m.ca, Pair(m.car.certificate, m.foreign_car.key)), "the key that belongs to it"),
    ],
    ids=["absent", "no certificate", "another key"],
)
def test_files_that_cannot_be_used_are_named_at_once(
    role: Role, choose: Callable[[Made, Path], str], said: str, made: Made, tmp_path: Path
) -> None:
    with pytest.raises(SessionError, match=said):
        open_session(role, [f"tls/127.0.0.1:1#{choose(made, tmp_path / 'absent.pem')}"])


def test_verification_of_the_name_can_be_left_out(made: Made, tmp_path: Path) -> None:
    with routing(made, made.elsewhere, tmp_path) as bare:
        words = parameters(made.ca, made.car, verify_name_on_connect="false")
        with open_session(Role.AGENT, [f"{bare}#{words}"]) as session:
            wait_until(lambda: list(session.info.routers_zid()))
        assert tls.failure(f"{bare}#{words}") is None


def test_other_endpoints_are_not_probed() -> None:
    for endpoint in ("tcp/127.0.0.1:1", "quic/127.0.0.1:1", "unixsock-stream//run/fleet.sock"):
        tls.check_files(endpoint)
        assert tls.failure(endpoint) is None
