"""The page as a person sees it, in a real browser."""

import re
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from io import BytesIO
from typing import Any

import numpy as np
import pytest

from fleet_bus import keys
from fleet_bus.clock import SYSTEM
from fleet_bus.messages import Assignment, Cut, Event, Label, ReachTube, ScenarioDocument, ServiceStatus, StateSample
from fleet_bus.messages.state import ENCODING as STATE
from fleet_bus.messages.tube import ENCODING as TUBE
from fleet_bus.router import Router
from fleet_bus.sessions import Role, open_session
from fleet_bus.zenoh_bus import ZenohBus
from side_info.documents.scenario import Scenario
from tests.browser import ARGUMENTS, CHROMIUM
from tests.fleet_dashboard.messages import PROFILE, contradiction, tube
from tests.integration.conftest import Process, Start
from tests.proxy import proxied
from tests.waiting import DEADLINE, wait_until

nicegui = pytest.importorskip("nicegui", reason="the page needs the extra `dashboard`")
sync_api = pytest.importorskip("playwright.sync_api", reason="the browser is driven by Playwright")

pytestmark = [
    pytest.mark.integration,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium: apt-get install chromium"),
]

Page = Any
WAIT_MS = 1000 * DEADLINE


class Fleet:
    """Vehicles and a server as the bus knows them, put ten times a second until closed."""

    def __init__(self, router: str, vehicles: int, *, named: str = "reach-1") -> None:
        self._open = ExitStack()
        self.bus = self._open.enter_context(ZenohBus(open_session(Role.SERVICE, [router])))
        self.names = [f"v{k}" for k in range(vehicles)]
        #: What tubes say of their server, which is any text.
        self.named = named
        self.told: dict[str, ReachTube] = {}
        self.moving = threading.Event()
        self.cuts: tuple[Cut, ...] = ()
        self.speaking = threading.Event()
        self.speaking.set()
        self._seq = 0
        self._stop = threading.Event()
        put = self.bus.publisher
        for name in self.names:
            self._open.enter_context(put(keys.profile(name), PROFILE.encoding(), cache=1)).put(PROFILE.encode())
        self._tubes = {name: self._open.enter_context(put(keys.tube(name), TUBE, cache=1)) for name in self.names}
        self._states = {name: self._open.enter_context(put(keys.state(name), STATE, cache=1)) for name in self.names}
        self._events = {
            name: self._open.enter_context(put(keys.event(name), Event.encoding(), cache=8)) for name in self.names
        }
        status = keys.service_status("reach", "reach-1")
        self._status = self._open.enter_context(put(status, ServiceStatus.encoding(), cache=1))
        self.alive = self._open.enter_context(self.bus.alive(keys.service("reach", "reach-1")))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def place(self, k: int) -> tuple[float, float]:
        """Where a vehicle is: on a square, and along x by a metre for ten samples while the fleet moves."""
        return 2.0 * (k % 15) + (0.1 * self._seq if self.moving.is_set() else 0.0), 2.0 * (k // 15)

    def _run(self) -> None:
        while not self._stop.wait(0.1):
            if self.speaking.is_set():
                self.put()

    def put(self) -> None:
        """A sample and a tube of each vehicle, and a status."""
        now = SYSTEM.time_ns()
        self._seq += 1
        for k, name in enumerate(self.names):
            x, y = self.place(k)
            self.told[name] = tube(name, at=(x, y), seq=self._seq, t=now, server=self.named, cuts=self.cuts, radius=0.6)
            sample = StateSample(epoch=1, seq=self._seq, t=now, x=np.array([0.5, x, y, 0.7]), u=np.zeros(1))
            self._states[name].put(sample.encode())
            self._tubes[name].put(self.told[name].encode())
        status = ServiceStatus(kind="reach", instance="reach-1", t=now, started=now)
        self._status.put(status.encode())

    def event(self, event: Event) -> None:
        """Tell something about a vehicle."""
        assert event.vehicle is not None
        self._events[event.vehicle].put(event.encode())

    def keep(self, key: str, encoding: str, payload: bytes) -> None:
        """Put a document for as long as the fleet is there."""
        self._open.enter_context(self.bus.publisher(key, encoding, cache=1)).put(payload)

    def close(self) -> None:
        """End all of it, as a process does that is killed."""
        self._stop.set()
        self._thread.join()
        self._open.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=list(ARGUMENTS))
        yield found
        found.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Page]:
    """A page whose errors, of scripts and on the console, are kept in ``page.errors``, and what it asks others for."""
    context = browser.new_context(viewport={"width": 1280, "height": 800}, color_scheme="light")
    opened = context.new_page()
    opened.set_default_timeout(WAIT_MS)
    opened.errors = []
    opened.on("pageerror", lambda error: opened.errors.append(str(error)))
    opened.on("console", lambda said: said.type == "error" and opened.errors.append(said.text))
    elsewhere = re.compile(r"^(?!https?://127\.0\.0\.1[:/]|data:|blob:)")
    opened.on("request", lambda asked: elsewhere.match(asked.url) and opened.errors.append(asked.url))
    yield opened
    context.close()


@pytest.fixture
def fleet(router: Router) -> Iterator[Fleet]:
    vehicles = Fleet(router.endpoints[0], 1)
    yield vehicles
    vehicles.close()


def opened(start: Start, router: Router, *options: str) -> tuple[Process, str]:
    """The page's process, and its address."""
    process = start("dashboard", "--port", "0", "--router", router.endpoints[0], *options)
    process.expect("page on ")
    (line,) = [line for line in process.lines if "page on " in line]
    return process, line.split()[-1]


def show(page: Page, url: str, script: str = "fleetMap.frame.polygons > 0") -> None:
    """Open the page, and wait until its map shows something."""
    page.goto(url)
    page.wait_for_function(f"window.fleetMap?.frame && ({script})")


def pixels(page: Page) -> np.ndarray:
    """What is on the screen (800, 1280, 3), read as it is written in a PNG without loss."""
    image = pytest.importorskip("matplotlib.image")
    return np.asarray(np.round(255 * image.imread(BytesIO(page.screenshot()))[..., :3]), dtype=int)


def on_screen(page: Page, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points of the plane (N, 2)."""
    return np.array(page.evaluate("(points) => points.map(([x, y]) => fleetMap.onScreen(x, y))", points.tolist()))


def ink(image: np.ndarray, at: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """How far from the ground's colour the pixels are around some places, at most (N,)."""
    found = []
    for x, y in np.round(at).astype(int):
        found.append(np.abs(image[y - 1 : y + 2, x - 1 : x + 2] - ground).sum(axis=2).max())
    return np.array(found)


def test_a_polygon_is_drawn_where_the_message_says(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    _, url = opened(start, router)
    show(page, url)
    page.get_by_label("names", exact=True).click()
    # From near, so that steps are far from each other, and lines of the grid are few.
    page.evaluate("fleetMap.zoom(fleetMap.camera.scale < 300 ? 300 / fleetMap.camera.scale : 1)")
    told = fleet.told["v0"]
    page.wait_for_function("fleetMap.frame.polygons == 3 && fleetMap.camera.scale >= 299")
    ground = np.array([255, 255, 255])
    drawn = pixels(page)
    for step in range(3):
        corners = told.center[step, :2] + told.outline[step]
        middles = (corners + np.roll(corners, -1, axis=0)) / 2
        # Of the nearer steps a line is strong, of the last one there is a filled set as well.
        assert (ink(drawn, on_screen(page, middles), ground) > 90).all(), step
    last = told.center[-1, :2] + told.outline[-1]
    middle = last.mean(axis=0)
    outside = on_screen(page, middle + 1.15 * (last - middle))
    inside = on_screen(page, middle + 0.93 * (last - middle))
    # A line of the grid may cross; it is faint.
    assert (ink(drawn, outside, ground) < 90).all()
    strong = ink(drawn, inside, ground)
    assert np.median(strong) > 30
    # The colour is that of its label in the legend: green.
    places = np.round(inside).astype(int)
    red, green, blue = np.median(drawn[places[:, 1], places[:, 0]], axis=0)
    assert green > red
    assert green > blue
    # Without sets they are gone.
    page.get_by_label("sets", exact=True).click()
    page.wait_for_function("fleetMap.frame.polygons == 0")
    page.wait_for_timeout(200)
    assert np.median(ink(pixels(page), inside, ground)) < 30
    assert page.errors == []


def test_vehicles_move_and_one_can_be_followed(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    _, url = opened(start, router)
    show(page, url)
    page.evaluate("fleetMap.zoom(0.1)")
    before = page.evaluate("fleetMap.place(0)")
    fleet.moving.set()
    page.wait_for_function(f"fleetMap.place(0)[0] > {before[0] + 0.5}")
    page.locator(".ag-cell[col-id=id]").first.click()
    page.wait_for_function("fleetMap.followed == 'v0'")
    page.wait_for_function("Math.hypot(fleetMap.camera.x - fleetMap.place(0)[0], fleetMap.camera.y) < 0.5")
    assert "cut away 50 %" in page.get_by_text(re.compile("guaranteed · area")).inner_text()
    # Hovered over, it tells its numbers.
    x, y = page.evaluate("fleetMap.onScreen(...fleetMap.place(0))")
    page.mouse.move(x, y)
    page.wait_for_function("!document.querySelector('.fleet-card').hidden")
    assert "v0" in page.locator(".fleet-card").inner_text()
    page.get_by_role("button", name="details").click()
    page.get_by_text("Profile, and where each bound is from").wait_for()
    page.get_by_text("m/s").first.wait_for()
    assert page.errors == []


def test_side_information_toggles(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    text = Scenario.load("parking-lot").text
    document = ScenarioDocument(scenario="parking-lot", version=2, text=text)
    fleet.keep(keys.document("parking-lot"), ScenarioDocument.encoding(), document.encode())
    fleet.cuts = (Cut("parking-lot", "P.x1", 1, 3),)
    _, url = opened(start, router)
    show(page, url, "fleetMap.regions.length == 2 && fleetMap.active.has('parking-lot/P')")
    page.get_by_text("cut away 50 %").first.wait_for()
    border = np.array([[1.998, y] for y in np.linspace(1.2, 3.0, 12)])
    page.wait_for_function("fleetMap.fitted")
    page.wait_for_timeout(300)
    ground = np.array([255, 255, 255])
    # Active, it is purple: more red and blue than green.
    there = ink(pixels(page), on_screen(page, border), ground)
    page.get_by_label("side information").click()
    page.get_by_text("area without side information").wait_for()
    page.wait_for_function("!fleetMap.info")
    page.wait_for_timeout(300)
    gone = ink(pixels(page), on_screen(page, border), ground)
    assert (there > 200).all()
    assert np.median(gone) < 90
    assert page.errors == []


def test_a_server_that_is_killed_shows_as_stale(page: Page, router: Router, start: Start) -> None:
    fleet = Fleet(router.endpoints[0], 2)
    try:
        _, url = opened(start, router)
        show(page, url)
        assert not page.get_by_role("alert").first.is_visible()
    finally:
        fleet.close()
    page.get_by_text(re.compile("reach server reach-1: gone, silent for [0-3] s")).wait_for()
    page.wait_for_function("[...fleetMap.frame.codes].every((code) => (code >> 8) & 7)")
    page.get_by_text("stale 2", exact=True).wait_for()
    assert page.errors == []


def test_a_contradiction_is_told_and_appears_in_the_timeline(
    page: Page, fleet: Fleet, router: Router, start: Start
) -> None:
    now = SYSTEM.time_ns()
    assignment = Assignment(scenario="lot", vehicle="v0", time_zero=now)
    fleet.keep(keys.assignment("lot", "v0"), Assignment.encoding(), assignment.encode())
    _, url = opened(start, router)
    show(page, url)
    page.get_by_role("tab", name="timeline").click()
    chart = page.locator(".fleet-right canvas").first
    chart.wait_for()
    orange = np.array([0xDD, 0x51, 0x27])

    def contradicted() -> int:
        box = chart.bounding_box()
        x, y = int(box["x"]), int(box["y"])
        part = pixels(page)[y : y + int(box["height"]), x : x + int(box["width"])]
        return int((np.abs(part - orange).sum(axis=2) < 12).sum())

    wait_until(lambda: contradicted() == 0)
    fleet.event(contradiction("v0", SYSTEM.time_ns(), message="it left the lot at the fence <b>north</b>"))
    page.get_by_text("v0 left its scenario: it left the lot at the fence <b>north</b>").wait_for()
    wait_until(lambda: contradicted() > 100)
    page.get_by_role("tab", name="events").click()
    page.get_by_text("contradiction", exact=True).wait_for()
    assert page.errors == []


def test_pause_and_go_back_and_live_again(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    _, url = opened(start, router)
    show(page, url)
    # From far, so that it does not leave the view.
    page.evaluate("fleetMap.zoom(0.1)")
    page.wait_for_function("fleetMap.frame.count == 1")
    first = page.evaluate("fleetMap.frame.time")
    fleet.moving.set()
    page.wait_for_function(f"fleetMap.frame.time > {first + 3}")
    page.get_by_label("pause").click()
    page.get_by_text("paused: this is how it was at").wait_for()
    page.wait_for_function("fleetMap.frame.past")
    paused, there = page.evaluate("fleetMap.frame.time"), page.evaluate("fleetMap.place(0)[0]")
    page.locator(".q-slider").click(position={"x": 4, "y": 10})
    page.wait_for_function(f"fleetMap.frame.past && fleetMap.frame.time < {paused - 2}")
    page.wait_for_function(f"fleetMap.place(0)[0] < {there - 1}")
    page.get_by_role("button", name="live").click()
    page.wait_for_function(f"!fleetMap.frame.past && fleetMap.frame.time > {paused}")
    assert page.errors == []


def test_two_hundred_vehicles_are_listed_searched_and_drawn(page: Page, router: Router, start: Start) -> None:
    fleet = Fleet(router.endpoints[0], 200, named='<img src=x onerror="window.hacked=1">')
    try:
        _, url = opened(start, router)
        show(page, url, "fleetMap.frame.count == 200 && fleetMap.ids.length == 200")
        page.get_by_text("200 vehicles", exact=True).wait_for()
        page.get_by_placeholder("search vehicle").fill("v150")
        page.wait_for_function("document.querySelectorAll('.ag-center-cols-container .ag-row').length == 1")
        page.get_by_label("zoom in").click()
        # From near, only those in view come.
        page.locator(".ag-cell[col-id=id]").first.click()
        there = "fleetMap.find('v150') >= 0"
        page.wait_for_function(f"{there} && fleetMap.frame.count < 100 && fleetMap.frame.hidden > 100")
        fleet.moving.set()
        before = page.evaluate("fleetMap.place(fleetMap.find('v150'))[0]")
        page.wait_for_function(f"{there} && fleetMap.place(fleetMap.find('v150'))[0] > {before + 0.3}")
        page.get_by_role("tab", name="services").click()
        page.get_by_text("<img src=x").first.wait_for()
        assert page.evaluate("window.hacked") is None
        assert page.errors == []
    finally:
        fleet.close()


@pytest.mark.parametrize("path", ["", "vehicle/nobody", "vehicle/v0"])
def test_without_vehicles_or_profile_no_page_is_blank(path: str, page: Page, router: Router, start: Start) -> None:
    _, url = opened(start, router)
    page.goto(url + path)
    said = {"": "no vehicle has been heard of yet"}.get(path, "nothing has been heard of")
    page.get_by_text(said).first.wait_for()
    assert page.errors == []


def test_bad_input_is_refused_and_said_and_moves_nothing(
    page: Page, fleet: Fleet, router: Router, start: Start
) -> None:
    _, url = opened(start, router)
    show(page, url)
    fleet.speaking.clear()
    page.wait_for_function("[...fleetMap.frame.codes].every((code) => (code >> 8) & 7)")
    before = page.evaluate("[...fleetMap.frame.outline]")
    good = fleet.told["v0"].encode()
    session = fleet.bus.session
    for payload, encoding in (
        (b"", TUBE), (b"\xc1" * 100, TUBE), (good[:-9], TUBE), (good, "application/msgpack;fleet.tube.v2"),
        (bytes(10**6), TUBE),
    ):  # fmt: skip
        session.put(keys.tube("v0"), payload, encoding=encoding)
    # Far away and of any size; and one of which nothing else is known.
    session.put(keys.tube("huge"), tube("huge", at=(1e38, -1e38), radius=1e37).encode(), encoding=TUBE)
    session.put(keys.tube("alone"), tube("alone", at=(1.0, 1.0)).encode(), encoding=TUBE)
    page.get_by_role("tab", name="services").click()
    page.get_by_text(re.compile("the page refused 1 messages: version")).wait_for()
    page.get_by_text(re.compile("the page refused . messages: malformed")).wait_for()
    page.wait_for_function("fleetMap.ids.length == 3 && fleetMap.find('alone') >= 0")
    page.wait_for_function("[...fleetMap.frame.owners].includes(fleetMap.find('v0'))")
    own = page.evaluate(
        "[...fleetMap.frame.owners].flatMap((owner, p) => owner != fleetMap.find('v0') ? [] : "
        "[...fleetMap.frame.outline.subarray(2 * p * fleetMap.frame.corners, 2 * (p + 1) * fleetMap.frame.corners)])"
    )
    assert own == pytest.approx(before, abs=1e-4)
    page.get_by_role("tab", name="vehicles").click()
    page.get_by_text(re.compile("its sets are too large to draw")).wait_for()
    assert page.errors == []


def test_a_lost_page_says_so_and_comes_back(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    process, url = opened(start, router)
    show(page, url)
    port = url.rstrip("/").rpartition(":")[2]
    process.end()
    page.get_by_text(re.compile("Not connected: what is shown is")).wait_for()
    start("dashboard", "--port", port, "--router", router.endpoints[0]).expect("page on ")
    page.wait_for_function("window.fleetMap?.frame && performance.now() - fleetMap.lastFrame < 1000")
    page.get_by_text(re.compile("Not connected")).wait_for(state="hidden")


def test_a_lost_router_is_said(page: Page, start: Start) -> None:
    with Router(["tcp/127.0.0.1:0"]) as router:
        _, url = opened(start, router)
        page.goto(url)
        page.wait_for_function("window.fleetMap")
    page.get_by_text("not connected to a router").wait_for()


def test_a_token_lets_in_and_without_it_nobody(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    process, url = opened(start, router, "--host", "0.0.0.0", "--token", "correct-horse-battery")
    port = re.search(r":(\d+)/", url)
    assert port is not None
    here = f"http://127.0.0.1:{port[1]}/"
    assert url.endswith("?token=correct-horse-battery")
    page.goto(here)
    page.get_by_text("a token is needed").wait_for()
    page.errors.clear()
    show(page, f"{here}?token=correct-horse-battery")
    assert page.url == here
    assert page.errors == []
    assert process.end() == 0


def test_behind_a_proxy_it_works_under_a_path(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    _, url = opened(start, router, "--root-path", "/fleet", "--token", "correct-horse-battery")
    port = re.search(r":(\d+)/", url)
    assert port is not None
    with proxied(int(port[1]), "/fleet") as outside:
        show(page, f"{outside}?token=correct-horse-battery")
        assert page.url == outside
        page.locator(".ag-cell[col-id=id]").first.click()
        page.get_by_role("button", name="details").click()
        page.wait_for_url(f"{outside}vehicle/v0")
        page.wait_for_function("window.fleetMap?.frame?.polygons > 0")
        assert page.errors == []


def test_the_demo_says_where_its_page_is_and_who_left(page: Page, start: Start) -> None:
    demo = start("demo", "--vehicles", "2", "--stray", "1", "--duration", "20", "--page-port", "0")
    demo.expect("page on ")
    (line,) = [line for line in demo.lines if "page on " in line]
    show(page, line.split()[-1])
    page.get_by_text(re.compile(r"svea2 left its scenario: scenario parking-lot \(")).wait_for()
    assert page.errors == []


def test_labels_are_explained_one_click_away(page: Page, fleet: Fleet, router: Router, start: Start) -> None:
    _, url = opened(start, router)
    show(page, url)
    page.locator("header button").first.click()
    page.get_by_text("What a label claims").wait_for()
    for label in Label:
        assert page.get_by_text(str(label), exact=True).first.is_visible()
