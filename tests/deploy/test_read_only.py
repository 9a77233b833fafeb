"""The command of every unit starts where nothing can be written but what its unit lets be written."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import yaml

from fleet_bus.router import Router
from tests.deploy.units import CONFIGURATION, DEPLOY, ROOT, Unit, units
from vehicle_agent import svea

pytestmark = [pytest.mark.integration, pytest.mark.slow]

UNITS = {unit.path.stem: unit for unit in units()}
READY = {
    "fleet-agent@": "agents ready: svea1",
    "fleet-reach": "reach server host ready",
    "fleet-router": "router listens on tcp/127.0.0.1:",
    "fleet-side-info": "side-info publishes no scenario",
}
#: Seconds that a start may take; it does not depend on it.
LONG = 90.0

#: Makes every mount of an own namespace read-only but the one folder given, leaves what the kernel makes up alone, as
#: ProtectSystem=strict does, and then becomes the command.
READ_ONLY = r"""
set -e
writable=$1; shift
mount --make-rprivate /
while read -r _ target kind _; do
    case $kind in proc|sysfs|cgroup*|devpts|mqueue|securityfs|debugfs|tracefs|bpf) continue;; esac
    mount -o remount,bind,ro "$target" 2>/dev/null || true
done < /proc/self/mounts
if [ -n "$writable" ]; then
    mount --bind "$writable" "$writable"
    mount -o remount,bind,rw "$writable"
fi
cd /
if touch "$HERE/probe" 2>/dev/null; then echo "the file system can be written" >&2; exit 99; fi
exec "$@"
"""


@cache
def namespaces_work() -> bool:
    """Whether this user may make mount namespaces."""
    if shutil.which("unshare") is None:
        return False
    tried = subprocess.run(
        ["unshare", "-m", "sh", "-c", "mount --make-rprivate / && mount --bind /tmp /tmp"],
        capture_output=True,
        check=False,
    )
    return tried.returncode == 0


class Started:
    """A process whose output is kept."""

    def __init__(self, command: list[str], environment: Mapping[str, str], folder: str) -> None:
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=dict(environment), cwd=folder
        )
        self.output = ""
        self._over = False
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as lines:
            for line in lines:
                with self._changed:
                    self.output += line
                    self._changed.notify_all()
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def wait_for(self, text: str) -> None:
        """Wait for ``text``, or the end of the process, which is a failure."""
        with self._changed:
            self._changed.wait_for(lambda: text in self.output or self._over, LONG)
        assert text in self.output, self.output

    def end(self) -> int:
        """Ask it to end; its exit code."""
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(LONG)
        self._reader.join(10)
        return code

    def kill(self) -> None:
        """End it whatever it does."""
        self.process.kill()
        self.process.wait(10)
        self._reader.join(10)


@contextmanager
def started(command: list[str], environment: Mapping[str, str], folder: str) -> Iterator[Started]:
    process = Started(command, environment, folder)
    try:
        yield process
    finally:
        process.kill()


@pytest.fixture
def configuration(tmp_path: Path) -> Path:
    """What the units expect in /etc/fleet-reach, without their optional files."""
    folder = tmp_path / "etc"
    (folder / "agents").mkdir(parents=True)
    profile = svea.profile().model_dump(mode="json", by_alias=True, exclude_none=True)
    (folder / "agents" / "svea1.yaml").write_text(yaml.safe_dump(profile, sort_keys=False), encoding="utf-8")
    router = (DEPLOY / "router.json5").read_text(encoding="utf-8")
    (folder / "router.json5").write_text(router.replace("tcp/[::]:7447", "tcp/127.0.0.1:0"), encoding="utf-8")
    return folder


def command_of(unit: Unit, configuration: Path, endpoint: str) -> list[str]:
    # Of two addresses for Prometheus the last one counts; the port of a unit may be in use here.
    more = "" if unit.path.stem == "fleet-router" else f"--router {endpoint} --metrics 0"
    words = [word.replace(CONFIGURATION, str(configuration)) for word in unit.command(more)]
    return [sys.executable, "-m", "fleet_cli", *words[1:]]


def environment_of(unit: Unit, cache_folder: Path, **more: str) -> dict[str, str]:
    """What systemd would set, and nothing of ours but where the program is."""
    found = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", **more}
    if "CacheDirectory" in unit.service:
        found["CACHE_DIRECTORY"] = str(cache_folder)
    return found


@pytest.fixture
def cache_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    return folder


@pytest.mark.parametrize("name", list(UNITS))
def test_it_starts_on_a_read_only_file_system(
    name: str, configuration: Path, cache_folder: Path, tmp_path: Path
) -> None:
    if not namespaces_work():
        pytest.skip("mount namespaces need root and a kernel that allows them")
    unit = UNITS[name]
    writable = str(cache_folder) if "CacheDirectory" in unit.service else ""
    environment = environment_of(unit, cache_folder, HOME="/", HERE=str(tmp_path))
    with Router(["tcp/127.0.0.1:0"]) as router:
        command = command_of(unit, configuration, router.endpoints[0])
        with started(["unshare", "-m", "sh", "-c", READ_ONLY, "sh", writable, *command], environment, "/") as process:
            process.wait_for(READY[name])
            assert process.end() == 0
    check_output(unit, process.output, cache_folder)


@pytest.mark.parametrize("name", list(UNITS))
def test_it_starts_where_home_and_working_folder_cannot_be_written(
    name: str, configuration: Path, cache_folder: Path
) -> None:
    unit = UNITS[name]
    # Below /proc not even root can write.
    environment = environment_of(unit, cache_folder, HOME="/proc/nowhere", XDG_CACHE_HOME="/proc/nowhere")
    with Router(["tcp/127.0.0.1:0"]) as router:
        with started(command_of(unit, configuration, router.endpoints[0]), environment, "/proc") as process:
            process.wait_for(READY[name])
            assert process.end() == 0
    check_output(unit, process.output, cache_folder)


def check_output(unit: Unit, output: str, cache_folder: Path) -> None:
    """Nothing was refused a place to write to; the kernels' is where the unit says."""
    told = (READY[unit.path.stem], "metrics on http://127.0.0.1:")
    lines = [line for line in output.splitlines() if not line.startswith(told)]
    expected = {"fleet-side-info": ["warning: no scenario is named, so none is published"]}
    assert lines == expected.get(unit.path.stem, [])
    kernels = cache_folder / "fleet-reach" / "kernels"
    assert kernels.is_dir() == ("CacheDirectory" in unit.service)


def test_without_its_cache_folder_the_reach_server_starts_and_says_what_it_costs(configuration: Path) -> None:
    environment = environment_of(UNITS["fleet-router"], Path("/"), HOME="/proc/nowhere", XDG_CACHE_HOME="/proc/nowhere")
    with Router(["tcp/127.0.0.1:0"]) as router:
        command = command_of(UNITS["fleet-reach"], configuration, router.endpoints[0])
        with started(command, environment, "/proc") as process:
            process.wait_for(READY["fleet-reach"])
            assert process.end() == 0
    assert "FLEET_KERNEL_CACHE" in process.output
