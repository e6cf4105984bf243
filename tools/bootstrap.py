# SPDX-License-Identifier: GPL-3.0-or-later
"""Create or update `.venv` on any machine that has Python, git and make.

`make` runs this before every target, with the first Python 3.11 or 3.13 that it finds (Blender's wheels
exist for these two only). It uses the standard library alone, and takes these steps where they are needed:

1. install the system packages that the wheels of Blender and MeshLab load (or name them, if it may not);
2. create `.venv`, or replace one that is not usable;
3. install the project into it, editable and with the extra `dev`, and check that both hosts load.

With the argument `core` it skips the hosts and installs only the extra `core-tests`; with `extension` it installs
nothing, because building the extension needs pip alone. With `docs` it skips the hosts, too, and installs the tools
that build the documentation. With `release` it installs everything, and the tools that build and check packages.

A stamp in `.venv` records what was installed for the present `pyproject.toml`. It reads UNFINISHED
while `.venv` is being changed, so that a setup that was killed half-way is recognised and repeated.

The terminal shows one line for each step and each large download. The output of pip and apt-get goes to
`build/setup.log`; its last lines are shown if one of them fails.
"""

import ctypes
import hashlib
import importlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import DEVNULL, PIPE, STDOUT
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv"
ENVIRONMENT_PYTHON = ENVIRONMENT / "bin" / "python"
STAMP = ENVIRONMENT / "setup-stamp"
UNFINISHED = "unfinished"
LOG = ROOT / "build" / "setup.log"
LOCK = ROOT / "build" / "setup.lock"
LOG_TAIL = 20  # lines that are shown after a failure
LARGE_DOWNLOAD = 30  # MB; larger downloads are shown

# By argument: the extras, and their description.
EXTRAS = {
    "extension": ("", "pip"),
    "core": ("core-tests", "the core and its tests (up to 60 MB to download, 200 MB on disk)"),
    "all": ("dev", "Blender and MeshLab as Python modules (up to 650 MB to download, 1.8 GB on disk)"),
    "docs": ("core-tests,docs", "the core and Sphinx (up to 125 MB to download)"),
    "all and docs": ("dev,docs", "Blender, MeshLab and Sphinx as Python modules (up to 690 MB to download)"),
    "release": (
        "dev,docs,release",
        "Blender, MeshLab, Sphinx and twine as Python modules (up to 695 MB to download)",
    ),
}

# The environments that serve each argument.
SERVED_BY = {
    "extension": tuple(EXTRAS),
    "core": tuple(EXTRAS),
    "docs": ("docs", "all and docs", "release"),
    "all": ("all", "all and docs", "release"),
    "all and docs": ("all and docs", "release"),
    "release": ("release",),
}
# The arguments that need neither Blender nor MeshLab.
WITHOUT_HOSTS = ("extension", "core", "docs")

# The modules that the core finds the extension by, see `zoomout_core/mesh/formats/blender_files.py`.
EXTENSION_ENTRY_POINTS = """[zoomout.extension]
main = blender_addon
demo = blender_addon.demo
"""

# The system libraries that the wheels load, and their Debian and Ubuntu packages. Blender opens
# libEGL only when it renders, and aborts the process when it is missing.
SYSTEM_LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libICE.so.6": "libice6",
    "libOpenGL.so.0": "libopengl0",
    "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXt.so.6": "libxt6",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libfontconfig.so.1": "libfontconfig1",
    "libfreetype.so.6": "libfreetype6",
    "libgomp.so.1": "libgomp1",
    "libxcb.so.1": "libxcb1",
    "libxkbcommon.so.0": "libxkbcommon0",
}


def main() -> None:
    with lock():
        set_up((sys.argv[1:] or ["all"])[0])


@contextmanager
def lock() -> Iterator[None]:
    """Hold a lock, so that two processes do not change `.venv` at the same time."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    LOCK.parent.mkdir(exist_ok=True)
    with LOCK.open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("waiting for another make to finish its setup")
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def set_up(wanted: str) -> None:
    keep = environment_is_usable()
    present = next((each for each in EXTRAS if keep and stamp() == finished_stamp(EXTRAS[each][0])), None)
    if {present, wanted} == {"all", "docs"}:
        wanted = "all and docs"
    extra, content = EXTRAS[wanted]
    hosts = wanted not in WITHOUT_HOSTS
    finished = present in SERVED_BY[wanted]
    if not finished:
        LOG.unlink(missing_ok=True)
    provide_system_packages(needs_venv=not keep, hosts=hosts)
    if finished:
        return
    if not keep:
        create_environment()
    if extra:
        install_project(extra, content)
    if hosts:
        check_hosts()
    STAMP.write_text(finished_stamp(extra))
    say("done")


def say(message: str) -> None:
    print(f"setup: {message}", flush=True)


def log_name() -> str:
    return LOG.relative_to(ROOT).as_posix()


def run_logged(command: list[str]) -> int:
    """Run a command without input, append its output to the log, and return its exit status."""
    LOG.parent.mkdir(exist_ok=True)
    with LOG.open("a", encoding="utf-8") as log:
        print("$", *command, file=log, flush=True)
        with subprocess.Popen(
            command, cwd=ROOT, stdin=DEVNULL, stdout=PIPE, stderr=STDOUT, text=True, errors="replace"
        ) as process:
            assert process.stdout is not None
            for line in process.stdout:
                print(line, end="", file=log, flush=True)
                if message := progress_message(line):
                    say(message)
    return process.returncode


def progress_message(line: str) -> str | None:
    """Return a message if a line of pip's output announces a step that can take minutes."""
    download = re.match(r"\s*Downloading (?:\S*/)?([^\s/]+?)-(\d[^-\s]*)-\S+ \((\d+)(?:\.\d+)? MB\)", line)
    if download and int(download[3]) >= LARGE_DOWNLOAD:
        return f"downloading {download[1]} {download[2]} ({download[3]} MB)"
    if packages := re.match(r"Installing collected packages: .+,", line):
        return f"unpacking {packages[0].count(',') + 1} packages"
    return None


def fail(reason: str) -> NoReturn:
    """Show the last lines of the log and the reason, and exit."""
    lines = LOG.read_text(encoding="utf-8").splitlines()[-LOG_TAIL:]
    sys.exit("\n".join([*(f"    {line}" for line in lines), f"setup: {reason} The whole log: {log_name()}"]))


def stamp() -> str | None:
    return STAMP.read_text() if STAMP.exists() else None


def finished_stamp(extra: str) -> str:
    """The path of `.venv` (its scripts break when it is moved), and a digest of the files that decide its content."""
    sources = (ROOT / "pyproject.toml").read_bytes() + Path(__file__).read_bytes() + extra.encode()
    return f"{ENVIRONMENT}: {hashlib.sha256(sources).hexdigest()}"


def environment_is_usable() -> bool:
    """Whether `.venv` was neither moved nor left unfinished, and has pip and a suitable Python.

    One that was made by hand, without a stamp, is accepted. If the user names a `PYTHON`, that version is required.
    """
    known = stamp()
    if not ENVIRONMENT_PYTHON.exists() or (known is not None and not known.startswith(f"{ENVIRONMENT}: ")):
        return False
    probe = subprocess.run(
        [ENVIRONMENT_PYTHON, "-c", "import sys, pip; print(*sys.version_info[:2])"],
        capture_output=True,
        text=True,
    )
    version = tuple(map(int, probe.stdout.split()))
    wanted = [sys.version_info[:2]] if os.environ.get("PYTHON") else [(3, 11), (3, 13)]
    return probe.returncode == 0 and version in wanted


def provide_system_packages(needs_venv: bool, hosts: bool) -> None:
    missing = missing_system_packages(needs_venv, hosts)
    if not missing:
        return
    if shutil.which("apt-get") is None:
        sys.exit(
            f"These are missing on this system: {', '.join(missing)}; install the packages that hold them"
            " (with dnf, pacman, zypper, …) and run make again."
        )
    command = ["apt-get", "install", "--no-install-recommends", *missing.values()]
    as_root = root_prefix()
    if as_root is None:
        sys.exit(
            "System packages are missing that only root may install: type `sudo apt-get update &&"
            f" sudo {' '.join(command)}` (or ask an administrator to), then run make again."
        )
    say(f"installing system packages with apt-get: {' '.join(missing.values())}... (log: {log_name()})")
    quiet = [*as_root, "env", "DEBIAN_FRONTEND=noninteractive"]
    run_logged([*quiet, "apt-get", "update"])
    run_logged([*quiet, *command, "--yes", "-o", "DPkg::Lock::Timeout=300"])
    if still_missing := missing_system_packages(needs_venv, hosts):
        fail(
            f"apt-get did not install {', '.join(still_missing.values())}:"
            " install the packages by hand and run make again."
        )


def missing_system_packages(needs_venv: bool, hosts: bool) -> dict[str, str]:
    """Missing system libraries, including those of Blender and MeshLab if needed, with their Debian packages."""
    if sys.platform != "linux":
        return {}
    wanted = SYSTEM_LIBRARIES if hosts else {}
    missing = {soname: package for soname, package in wanted.items() if not loads(soname)}
    importlib.invalidate_caches()
    if needs_venv and importlib.util.find_spec("ensurepip") is None:  # Debian packs it separately
        major, minor = sys.version_info[:2]
        missing["Python's ensurepip"] = f"python{major}.{minor}-venv"
    return missing


def loads(soname: str) -> bool:
    try:
        ctypes.CDLL(soname)
    except OSError:
        return False
    return True


def root_prefix() -> list[str] | None:
    """The prefix of a command to run it as root; None if that is not permitted without a password."""
    if os.geteuid() == 0:
        return []
    if shutil.which("sudo") and subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode == 0:
        return ["sudo", "-n"]
    return None


def create_environment() -> None:
    say(f"creating .venv with Python {sys.version.split()[0]} ({sys.executable})")
    if ENVIRONMENT.exists():
        shutil.rmtree(ENVIRONMENT)
    ENVIRONMENT.mkdir()
    STAMP.write_text(UNFINISHED)
    venv.create(ENVIRONMENT, symlinks=True, with_pip=True)
    # An up-to-date pip resumes downloads that break off.
    if pip_install("--upgrade", "pip") != 0:
        fail("pip could not update itself: fix the cause above and run make again.")


def install_project(extra: str, content: str) -> None:
    say(f"installing {content}... (log: {log_name()})")
    STAMP.write_text(UNFINISHED)
    status = pip_install("--prefer-binary", "--editable", f".[{extra}]")
    STAMP.unlink()  # also when pip failed: it rolls back unfinished installs
    if status != 0:
        fail("pip could not install the project: fix the cause above and run make again.")
    register_extension()


def register_extension() -> None:
    """Make the Blender extension, which the wheel leaves out, importable and known to the core."""
    (packages,) = ENVIRONMENT.glob("lib/python3*/site-packages")
    (packages / "source_folder.pth").write_text(f"{ROOT}\n")
    metadata = packages / "zoomout_extension-0.dist-info"
    metadata.mkdir(exist_ok=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: zoomout-extension\nVersion: 0\n")
    (metadata / "entry_points.txt").write_text(EXTENSION_ENTRY_POINTS)


def pip_install(*arguments: str) -> int:
    """Run pip in `.venv`, and return its exit status.

    Modules are compiled when they are first imported: compiling all 7,900 takes 35 s, half of the setup, while the
    tests import 1,700.
    """
    pip = [str(ENVIRONMENT_PYTHON), "-m", "pip", "--no-input", "--disable-pip-version-check"]
    return run_logged([*pip, "install", "--no-compile", "--progress-bar", "off", *arguments])


def check_hosts() -> None:
    say("loading Blender and MeshLab once")
    for module in ("bpy", "pymeshlab"):  # a process each: bpy does not load after pymeshlab
        probe = subprocess.run([ENVIRONMENT_PYTHON, "-c", f"import {module}"], capture_output=True, text=True)
        if probe.returncode != 0:
            reason = (probe.stderr.strip().splitlines() or [f"exit status {probe.returncode}"])[-1]
            sys.exit(f"{module} does not load ({reason}): fix that, or start again with `make clean`.")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\nThe setup was interrupted: run make again to continue.")
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"The setup of .venv failed ({error}): fix the cause and run make again.")
