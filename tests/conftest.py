"""What every test can rely on: a fresh log, the same random examples in every run, kernels that are compiled."""

import functools
import io
import shlex
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import nullcontext, redirect_stderr
from pathlib import Path
from typing import Any

import pytest
import structlog
from hypothesis import HealthCheck, is_hypothesis_test, settings

from tests.examples import asked, campaign, examples, seed, seeded

# No test depends on the speed of the machine: neither on how long an example takes nor on how fast it is drawn.
settings.register_profile(
    "fleet",
    derandomize=not seeded(),
    deadline=None,
    max_examples=examples(100),
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("fleet")

#: Seconds between two lines on how far a campaign is with one property.
_PERIOD = 30.0


@pytest.fixture(autouse=True)
def _fresh_logging() -> Iterator[None]:
    """A command run in this process sends its log to a stream that is gone with its test."""
    yield
    structlog.reset_defaults()


# Before the plugins whose options are set here.
@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """A campaign has its seed, and no limit of time for a test."""
    if seeded():
        config.option.hypothesis_seed = str(seed())
    if campaign():
        config.option.timeout = 0


def pytest_report_header() -> str | None:
    """How to repeat a campaign."""
    return f"random examples: {asked()}" if campaign() else None


# Before tests are selected by their marks.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Properties that Hypothesis tries are marked as such; a campaign tells how far it is with each.

    What runs in real time comes first in a worker: it takes longest.
    """
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: not in_real_time(item.path))
    for item in items:
        test = getattr(item, "obj", None)
        if is_hypothesis_test(test):
            item.add_marker("property")
            if campaign():
                _progress.follow(config, test)


@functools.cache
def in_real_time(path: Path) -> bool:
    """Whether a file has tests that start processes, which work in real time."""
    return "mark.integration" in path.read_text(encoding="utf-8")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object:
    """Workers share a session by files, so that what the tests of one have in common is computed once.

    All files that run in real time count as two, which mostly wait: so few do not slow each other down. (Not by
    ``--dist loadgroup``: that puts groups into node ids, which pytest 9.2 no longer takes, and so groups nothing.)
    """
    if config.getoption("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Files(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            name = nodeid.partition("::")[0]
            if not in_real_time(config.rootpath / name):
                return name
            # About as long each.
            return "real time, a to o" if Path(name).stem.removeprefix("test_") < "p" else "real time, p to z"

    return Files(config, log)


class _Progress:
    """Tells from time to time how many examples the test that runs has tried."""

    def __init__(self) -> None:
        self.count, self.told = 0, 0.0

    def restart(self) -> None:
        self.count, self.told = 0, time.monotonic()

    def follow(self, config: pytest.Config, test: Any) -> None:
        inner = test.hypothesis.inner_test
        # Parameters of one test share it.
        if getattr(inner, "followed", False):
            return

        @functools.wraps(inner)
        def counted(*args: Any, **kwargs: Any) -> Any:
            self.count += 1
            if time.monotonic() > self.told + _PERIOD:
                self.told = time.monotonic()
                tell(config, f"  {self.count} examples so far")
            return inner(*args, **kwargs)

        counted.followed = True  # type: ignore[attr-defined]
        test.hypothesis.inner_test = counted


_progress = _Progress()


def pytest_runtest_setup() -> None:
    """Examples are counted for each test."""
    _progress.restart()


def tell(config: pytest.Config, line: str) -> None:
    """Write a line to the terminal, whatever is captured."""
    reporter, capture = (config.pluginmanager.getplugin(name) for name in ("terminalreporter", "capturemanager"))
    if reporter is not None:
        with nullcontext() if capture is None else capture.global_and_fixture_disabled():
            reporter.write_line(line)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """What fails in a campaign says how to repeat it."""
    report = yield
    if campaign() and report.failed:
        report.sections.append(("repeat", f"{asked()} {sys.executable} -m pytest {shlex.quote(item.nodeid)}"))
    return report


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile kernels before the first test that needs them: its limit of time is there to end what hangs."""
    config = session.config
    if config.option.collectonly or not session.items or "reach_server.numeric.jit" not in sys.modules:
        return
    # The process that started this worker has seen to it.
    if not hasattr(config, "workerinput"):
        make_kernels_ready(config)


# Before the plugin that starts the workers.
@pytest.hookimpl(tryfirst=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile kernels once, not in each worker; which tests the workers will find is not known yet."""
    config = session.config
    if getattr(config.option, "tx", None) and not config.option.collectonly:
        make_kernels_ready(config)


def make_kernels_ready(config: pytest.Config) -> None:
    """Compile what is not in the cache, and say how long that took."""
    from reach_server.service import warm_up

    began = time.monotonic()
    tell(config, "making kernels ready: seconds if they are in the cache, else minutes …")
    try:
        with redirect_stderr(io.StringIO()):
            warm_up.main()
    # The tests say better what is wrong.
    except Exception as error:
        tell(config, f"that failed: {type(error).__name__}: {error}")
    tell(config, f"kernels took {time.monotonic() - began:.1f} s")
