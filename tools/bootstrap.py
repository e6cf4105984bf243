"""Create or update `.venv`, so that a machine with Python, git and make needs nothing by hand.

`make` runs this before every target, with the first Python 3.11 or 3.13 that it finds (Blender's wheels
exist for these two only). It uses the standard library alone and does, each only where needed:

1. install the system packages that the wheels of Blender and MeshLab load (or name them, if it may not);
2. create `.venv`, also in place of one that cannot be used;
3. install the project into it, editable and with the extra `dev`, and see that both hosts load.

With the argument `core` it leaves the hosts out, and installs the extra `core-tests` alone; with `docs` it installs
what makes the documentation as well, and with `release` what builds and checks packages.

A stamp in `.venv` records what was installed for the present `pyproject.toml`. It reads UNFINISHED
while `.venv` is being changed, so that a set-up that was killed half-way is recognised and made anew.
"""

import ctypes
import hashlib
import importlib
import importlib.util
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv"
ENVIRONMENT_PYTHON = ENVIRONMENT / "bin" / "python"
STAMP = ENVIRONMENT / "setup-stamp"
UNFINISHED = "unfinished"

# By argument: the extras, and what they add. An environment for one that stands later serves for those before it.
EXTRAS = {
    "core": ("core-tests", "25 MB to download, 200 MB on disk"),
    "all": ("dev", "650 MB to download, 375 MB of them for Blender, and 1.6 GB on disk"),
    "docs": ("dev,docs", "40 MB to download after the others"),
    "release": ("dev,docs,release", "5 MB to download after the others"),
}

# What the wheels load from the system, and the Debian and Ubuntu packages that hold it. Blender opens
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
    wanted = (sys.argv[1:] or ["all"])[0]
    keep = environment_is_usable()
    provide_system_packages(needs_venv=not keep, hosts=wanted != "core")
    enough = list(EXTRAS)[list(EXTRAS).index(wanted) :]
    if keep and stamp() in [finished_stamp(EXTRAS[each][0]) for each in enough]:
        return
    if not keep:
        create_environment()
    install_project(*EXTRAS[wanted])
    if wanted != "core":
        check_hosts()
    STAMP.write_text(finished_stamp(EXTRAS[wanted][0]))
    say("done")


def say(message: str) -> None:
    print(f"setup: {message}", flush=True)


def stamp() -> str | None:
    return STAMP.read_text() if STAMP.exists() else None


def finished_stamp(extra: str) -> str:
    """Where `.venv` stands (its scripts break when it is moved), and a digest of what decides its content."""
    sources = (ROOT / "pyproject.toml").read_bytes() + Path(__file__).read_bytes() + extra.encode()
    return f"{ENVIRONMENT}: {hashlib.sha256(sources).hexdigest()}"


def environment_is_usable() -> bool:
    """Whether `.venv` was neither moved nor left unfinished, and has pip and a Python that fits.

    One that was made by hand, without a stamp, will do. If the user names a `PYTHON`, that version fits.
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
    say(f"installing system packages with apt-get: {' '.join(missing.values())}")
    output = apt_get(as_root, ["update"])
    output += apt_get(as_root, [*command[1:], "--yes", "-o", "DPkg::Lock::Timeout=300"])
    if still_missing := missing_system_packages(needs_venv, hosts):
        print(output, file=sys.stderr)
        sys.exit(
            f"apt-get did not provide {', '.join(still_missing.values())} (its output is above):"
            " install them by hand and run make again."
        )


def missing_system_packages(needs_venv: bool, hosts: bool) -> dict[str, str]:
    """What the system lacks, for Blender and MeshLab too if they are to load, with the Debian package that holds it."""
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
    """What to put before a command to run it as root: None if that is not permitted without a password."""
    if os.geteuid() == 0:
        return []
    if shutil.which("sudo") and subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode == 0:
        return ["sudo", "-n"]
    return None


def apt_get(as_root: list[str], arguments: list[str]) -> str:
    """Run apt-get without questions, and return all that it printed."""
    return subprocess.run(
        [*as_root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ).stdout


def create_environment() -> None:
    say(f"creating .venv with Python {sys.version.split()[0]} ({sys.executable})")
    if ENVIRONMENT.exists():
        shutil.rmtree(ENVIRONMENT)
    ENVIRONMENT.mkdir()
    STAMP.write_text(UNFINISHED)
    # An up-to-date pip resumes downloads that break off.
    venv.create(ENVIRONMENT, symlinks=True, with_pip=True, upgrade_deps=True)


def install_project(extra: str, size: str) -> None:
    say(f"installing the project with the extra {extra} (new: {size})")
    STAMP.write_text(UNFINISHED)
    pip = [str(ENVIRONMENT_PYTHON), "-m", "pip", "install", "--prefer-binary", "--editable", f".[{extra}]"]
    status = subprocess.run(pip, cwd=ROOT).returncode
    STAMP.unlink()  # also when pip failed: it undoes what it cannot finish
    if status != 0:
        sys.exit("pip could not install the project: see its reason above, then run make again.")
    # The wheel leaves the Blender extension out, a zip of its own: the demo, tests and tools take it from here.
    (packages,) = ENVIRONMENT.glob("lib/python3*/site-packages")
    (packages / "source_folder.pth").write_text(f"{ROOT}\n")


def check_hosts() -> None:
    say("loading Blender and MeshLab once")
    for module in ("bpy", "pymeshlab"):  # a process each: bpy does not load after pymeshlab
        probe = subprocess.run([ENVIRONMENT_PYTHON, "-c", f"import {module}"], capture_output=True, text=True)
        if probe.returncode != 0:
            reason = (probe.stderr.strip().splitlines() or [f"exit status {probe.returncode}"])[-1]
            sys.exit(f"{module} does not load ({reason}): mend that, or begin anew with `make clean`.")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("\nThe set-up was interrupted; the next make takes it up again.")
    except (OSError, subprocess.CalledProcessError) as error:
        sys.exit(f"The set-up of .venv failed ({error}): mend that and run make again.")
