"""``fleet --version``."""

import re
import subprocess
import sys
from importlib import metadata


def test_the_version_is_printed_with_what_else_matters() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "fleet_cli", "--version"], capture_output=True, text=True, check=True
    )  # fmt: skip
    version = re.escape(metadata.version("fleet-reach"))
    assert re.fullmatch(
        rf"fleet-reach {version} \(Python 3\.\d+\.\d+, eclipse-zenoh [\d.]+, numpy [\d.]+\)\n", done.stdout
    )
    assert not done.stderr
