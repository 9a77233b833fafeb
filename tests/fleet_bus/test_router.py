"""The embedded router: real ports, clear refusals, a port that is free again at once."""

import json
from pathlib import Path

import pytest
import zenoh

from fleet_bus.errors import SessionError, UsageError
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session

ANY_PORT = "tcp/127.0.0.1:0"
pytestmark = pytest.mark.integration

OWN_SETTINGS: dict[str, object] = {
    "mode": "router",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "timestamping/enabled": True,
    "timestamping/drop_future_timestamp": False,
    "adminspace/permissions": {"read": True, "write": False},
    "transport/shared_memory/enabled": False,
    "transport/unicast/max_sessions": 10_000,
    "transport/link/tx/lease": 2000,
}


def write(directory: Path, text: str) -> Path:
    file = directory / "router.json5"
    file.write_text(text)
    return file


def test_port_zero_becomes_a_real_port_on_every_endpoint() -> None:
    with Router([ANY_PORT, ANY_PORT]) as router:
        assert len(set(router.endpoints)) == 2
        assert not any(endpoint.endswith(":0") for endpoint in router.endpoints)
        for endpoint in router.endpoints:
            with open_session(Role.VIEWER, [endpoint]) as session:
                assert len(list(session.info.routers_zid())) == 1


def test_port_in_use_is_named_with_the_way_out() -> None:
    with Router([ANY_PORT]) as router:
        port = router.endpoints[0].rpartition(":")[2]
        with pytest.raises(SessionError) as refused:
            Router(router.endpoints)
    assert str(refused.value) == (
        f"port {port} on 127.0.0.1 is in use: stop the other router, or choose another with --port"
    )


def test_an_address_that_is_not_ours_is_refused_without_the_places_in_zenohs_source() -> None:
    with pytest.raises(SessionError, match="cannot start") as refused:
        Router(["tcp/192.0.2.77:7447"])
    assert ".rs" not in str(refused.value)


def test_closing_frees_the_port_at_once_even_with_a_session_connected() -> None:
    with Router([ANY_PORT]) as router:
        endpoints = router.endpoints
        with open_session(Role.SERVICE, endpoints):
            for _ in range(3):
                router.close()
                router = Router(endpoints)
            assert router.endpoints == endpoints
            router.close()
            router.close()


def test_malformed_endpoint_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match=r"'tcp/127\.0\.0\.1' is not an endpoint"):
        Router(["tcp/127.0.0.1"])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{mode:", "expected"),
        ("{mode: 'router', listenn: {}}", "line 1, column 18: unknown field `listenn`"),
        ("{mode: 'peer'}", "mode is 'peer'"),
        ("{listen: {endpoints: ['nonsense']}}", "Endpoints must be of the form"),
    ],
)
def test_bad_file_is_named_with_what_is_wrong(tmp_path: Path, text: str, complaint: str) -> None:
    file = write(tmp_path, text)
    with pytest.raises(UsageError) as refused:
        Router(config_file=file)
    assert str(file) in str(refused.value)
    assert complaint in str(refused.value)
    assert ".rs" not in str(refused.value)


def test_absent_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"absent\.json5: No such file"):
        Router(config_file=tmp_path / "absent.json5")


def test_file_says_where_to_listen_unless_told_otherwise(tmp_path: Path) -> None:
    file = write(tmp_path, "{listen: {endpoints: ['tcp/127.0.0.1:0', 'tcp/127.0.0.1:0']}}")
    with Router(config_file=file) as router:
        assert len(router.endpoints) == 2
    with Router([ANY_PORT], config_file=file) as router:
        assert len(router.endpoints) == 1


def test_file_keeps_its_word_and_the_fleet_fills_in_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[zenoh.Config] = []
    really_open = zenoh.open

    def open_and_note(config: zenoh.Config) -> zenoh.Session:
        opened.append(config)
        return really_open(config)

    monkeypatch.setattr(zenoh, "open", open_and_note)
    file = write(tmp_path, "{transport: {unicast: {max_sessions: 7}}, metadata: {name: 'here'}}")
    with Router([ANY_PORT], config_file=file):
        pass
    with Router([ANY_PORT]):
        pass
    from_file, own = ({path: json.loads(config.get_json(path)) for path in OWN_SETTINGS} for config in opened)
    assert own == dict(OWN_SETTINGS)
    assert from_file == dict(OWN_SETTINGS) | {"transport/unicast/max_sessions": 7}


def test_file_that_denies_everything_still_tells_its_port(tmp_path: Path) -> None:
    deny = "access_control: {enabled: true, default_permission: 'deny', rules: [], subjects: [], policies: []}"
    file = write(tmp_path, f"{{listen: {{endpoints: ['{ANY_PORT}']}}, {deny}}}")
    with Router(config_file=file) as router:
        assert not router.endpoints[0].endswith(":0")


def test_closed_admin_space_leaves_the_endpoints_as_configured(tmp_path: Path) -> None:
    file = write(tmp_path, "{adminspace: {enabled: true, permissions: {read: false, write: false}}}")
    with Router([ANY_PORT], config_file=file) as router:
        assert router.endpoints == (ANY_PORT,)
