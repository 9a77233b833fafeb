"""Sessions over a router in this process."""

from collections.abc import Iterator

import pytest
import zenoh

from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from tests.waiting import wait_until


@pytest.fixture
def router() -> Iterator[Router]:
    with Router(["tcp/127.0.0.1:0"]) as running:
        yield running


@pytest.fixture
def service(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.SERVICE, router.endpoints) as session:
        yield session


@pytest.fixture
def agent(router: Router) -> Iterator[zenoh.Session]:
    with open_session(Role.AGENT, router.endpoints) as session:
        wait_until(lambda: list(session.info.routers_zid()))
        yield session
