"""Build the wheel, install it into a fresh environment, and run it from an empty folder: all that it needs is in it.

``wheel.py FOLDER`` makes what is handed on: a source distribution, a wheel for every platform, and one for this Python
on Linux and x86-64 that brings machine code of the kernels along.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PINNED = ROOT / "requirements" / "runtime.txt"
#: Those beside the one that all else is tried with.
NEWER = ("3.12", "3.13", "3.14")
PACKAGES = tuple(sorted(path.parent for path in ROOT.glob("*/__init__.py")))


def run(*words: str | Path, cwd: Path) -> str:
    """What a command prints; this one ends where it fails. Neither this tree nor this environment is seen by it."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    done = subprocess.run(words, cwd=cwd, env=kept, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words))} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def files() -> set[str]:
    """What the packages hold, as names inside of the wheel."""
    found = (path for package in PACKAGES for path in package.rglob("*") if path.is_file())
    return {path.relative_to(ROOT).as_posix() for path in found if path.parent.name != "__pycache__"}


def copied(folder: Path) -> Path:
    """A copy of the sources: what an older build has left in this tree is not in it."""
    source = folder / "source"
    for package in PACKAGES:
        shutil.copytree(package, source / package.name, ignore=shutil.ignore_patterns("__pycache__", "machine_code"))
    for name in ("pyproject.toml", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, source)
    return source


def build(source: Path, folder: Path, *options: str) -> Path:
    """Path of the wheel."""
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    settings = [f"--config-settings=--build-option={option}" for option in options]
    folder.mkdir(exist_ok=True)
    before = set(folder.glob("*.whl"))
    words = ("wheel", "-q", "--no-deps", "--no-index", "--no-build-isolation", *settings, "-w", folder, source)
    run(*pip, *words, cwd=folder)
    (wheel,) = set(folder.glob("*.whl")) - before
    return wheel


def distribute(output: Path) -> int:
    """Write the distributions to ``output``; their names are printed."""
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = copied(folder)
        made = [build(source, folder / "plain")]
        script = "import sys; from setuptools import build_meta; print(build_meta.build_sdist(sys.argv[1]))"
        run(sys.executable, "-c", script, folder / "plain", cwd=source)
        made += (folder / "plain").glob("*.tar.gz")
        code = source / "reach_server" / "numeric" / "machine_code"
        environment = {**os.environ, "PYTHONPATH": str(source)}
        subprocess.run(
            [sys.executable, ROOT / ".ci" / "machine_code.py", code], cwd=folder, env=environment, check=True
        )
        shutil.rmtree(source / "build", ignore_errors=True)
        tag = f"cp{sys.version_info[0]}{sys.version_info[1]}"
        made.append(build(source, folder / "native", f"--python-tag={tag}", "--plat-name=linux_x86_64"))
        for path in made:
            shutil.copy(path, output)
            print(f"{output / path.name}: {path.stat().st_size / 2**20:.1f} MB")
    return 0


def install(wheel: Path, environment: Path) -> Path:
    """Folder of the commands of a fresh environment with the wheel, which sees the dependencies of this one."""
    venv.create(environment, with_pip=False, symlinks=True)
    commands = environment / "bin"
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", commands / "python")
    run(*pip, "install", "-q", "--no-deps", "--no-index", wheel, cwd=environment)
    (packages,) = environment.glob("lib/python*/site-packages")
    # Such a folder is searched last, and its own .pth files, an editable install among them, are not read.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return commands


def python_of(version: str) -> str | None:
    """A Python of a version that is on this machine, on the path or where pyenv keeps them, and that runs."""
    kept = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    for found in (shutil.which(f"python{version}"), *map(str, reversed(kept))):
        # What pyenv puts on the path runs only where that version is chosen.
        if found is not None and not subprocess.run([found, "-c", ""], capture_output=True, check=False).returncode:
            return found
    return None


def try_other_pythons(wheel: Path, folder: Path) -> None:
    """Install the wheel with its pinned dependencies for each newer Python on this machine, and import all of it."""
    uv = Path(sys.executable).with_name("uv")
    if not uv.exists():
        print("other Pythons: not tried, there is no uv")
        return
    modules = sorted(name.removesuffix(".py").replace("/", ".") for name in files() if name.endswith(".py"))
    wanted = [name for name in modules if name.partition(".")[0] not in ("benchmarks", "fleet_cli")]
    script = "import importlib, sys\nfor name in sys.argv[1:]: importlib.import_module(name)"
    for version in NEWER:
        found = python_of(version)
        if found is None:
            print(f"Python {version}: not on this machine")
            continue
        environment = folder / version
        run(uv, "venv", "--quiet", "--python", found, environment, cwd=folder)
        subprocess.run(
            [ROOT / ".ci" / "install", Path(sys.executable).parent, "--require-hashes", "-r", PINNED],
            env={**os.environ, "INTO": str(environment / "bin" / "python")}, check=True,
        )  # fmt: skip
        install = ("pip", "install", "--quiet", "--no-deps", "--python", environment / "bin" / "python", wheel)
        run(uv, *install, cwd=folder)
        plain = [name for name in wanted if not name.endswith(("__main__", "__init__"))]
        run(environment / "bin" / "python", "-c", script, *plain, cwd=folder)
        run(environment / "bin" / "fleet", "scenario", "list", cwd=folder)
        print(f"Python {version}: installed, {len(plain)} modules imported, run")


def main() -> int:
    """0 if everything is in the wheel and runs; else what is wrong is printed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = build(copied(folder), folder / "wheels")
        missing = files() - set(zipfile.ZipFile(wheel).namelist())
        if missing:
            sys.exit(f"not in {wheel.name}: {', '.join(sorted(missing))}")
        commands = install(wheel, folder / "environment")
        empty = folder / "empty"
        empty.mkdir()
        run(commands / "fleet", "--help", cwd=empty)
        listed = run(commands / "fleet", "scenario", "list", cwd=empty)
        absent = [path.stem for path in ROOT.glob("side_info/scenarios/*.yaml") if path.stem not in listed]
        if absent:
            sys.exit(f"fleet scenario list does not name {', '.join(absent)}:\n{listed}")
        where = run(commands / "python", "-c", "import reach_server.sets as s; print(s.__file__)", cwd=empty)
        if not Path(where.strip()).is_relative_to(folder):
            sys.exit(f"reach_server.sets comes from {where.strip()}, not from the wheel")
        print(f"{wheel.name}: built, installed, run")
        try_other_pythons(wheel, folder)
    return 0


if __name__ == "__main__":
    sys.exit(distribute(Path(sys.argv[1]).resolve()) if sys.argv[1:] else main())
