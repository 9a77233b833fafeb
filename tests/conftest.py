"""What every test can rely on."""

from collections.abc import Iterator

import pytest
import structlog


@pytest.fixture(autouse=True)
def _fresh_logging() -> Iterator[None]:
    """A command run in this process sends its log to a stream that is gone with its test."""
    yield
    structlog.reset_defaults()
