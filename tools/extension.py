# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the Blender extension: one zip per platform, with the wheels of the core's dependencies except numpy.

`make extension` writes `dist/ID-VERSION-PLATFORM.zip` for this machine's platform, or for those given as arguments;
`--all` stands for every platform. It needs Python 3.11 or newer with pip alone, so it also runs where make is missing.
Wheels are those of the package index, unchanged, with the versions and hashes of `tools/wheels/`: a file for each
Python of Blender, and one for the tools that build the core's own wheel and the documentation. To change a version,
edit it there, then run `python tools/extension.py --lock`, which updates the hashes.

A zip contains only the files that `SHIPPED` and `DOCUMENTS` name; its bytes depend only on the tree and the wheels.
"""

import argparse
import hashlib
import importlib.util
import os
import platform as machine
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ADDON = ROOT / "blender_addon"
DOCS = ROOT / "docs"
LOCKS = ROOT / "tools" / "wheels"
DOWNLOADS = ROOT / "build" / "wheels"
DIST = ROOT / "dist"

MANIFEST = "blender_manifest.toml"
# The parts of the add-on that are shipped, and those that are excluded; a new folder must be in one of the two.
SHIPPED = (
    "*.py",
    "adapters/*.py",
    "cli/*.py",
    "mesh_data/**/*.py",
    "operators/**/*.py",
    "presets/**/*.py",
    "properties/*.py",
    "scene/*.py",
    "services/**/*.py",
    "storage/*.py",
    "ui/**/*.py",
    "viewport/*.py",
)
NOT_SHIPPED = ("demo/*.py",)
# Texts of `docs` that become pages in the zip, with their pictures.
DOCUMENTS = ("blender.md", "dress_ja.md", "libraries.md", "options.md", "transfer.md", "whats_new.md")
# The files that the core's own wheel is built from.
CORE = (
    "pyproject.toml",
    "README.md",
    "LICENSE",
    "zoomout_core/**/*.py",
    "zoomout_core/**/*.html",
    "zoomout_core/**/*.po",
    "zoomout_core/py.typed",
)

# A page's template: lines of readable length, in the browser's light or dark colours.
PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark }}
body {{ font-family: sans-serif; line-height: 1.5; max-width: 50rem; margin: 2rem auto; padding: 0 1rem }}
img {{ max-width: 100% }}
pre {{ overflow-x: auto }}
td, th {{ text-align: left; vertical-align: top; padding: 0.3rem 1rem 0.3rem 0 }}
</style>
{body}
</html>
"""

# Python 3.11 is Blender's until 5.0, 3.13 from 5.1 on.
PYTHONS = ("cp311", "cp313")
# The tags of the wheels that run wherever Blender 4.2 does: glibc 2.28, macOS 12 (scipy has none for 11). Those for
# macOS 14 would use Apple's BLAS, which threadpoolctl cannot limit to one thread.
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux_2_17_x86_64"),
    "macos-arm64": ("macosx_12_0_arm64",),
    "macos-x64": ("macosx_12_0_x86_64",),
    "windows-x64": ("win_amd64",),
}
# Blender's names for what Python calls systems and processors.
SYSTEMS = {"darwin": "macos", "win32": "windows"}
PROCESSORS = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64"}
# Blender runs here, but not all wheels exist.
UNSUPPORTED = {"windows-arm64": "robust-laplacian and fast-simplification have no wheels for it"}

# The earliest time in a zip file: seconds since 1970, and a date.
EPOCH = 315532800
EPOCH_DATE = (1980, 1, 1, 0, 0, 0)


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the Blender extension, one zip a platform.")
    parser.add_argument(
        "platforms", nargs="*", metavar="PLATFORM", help=f"of {', '.join(PLATFORMS)} (default: this one)"
    )
    parser.add_argument("--all", action="store_true", help="build for every platform")
    parser.add_argument("--lock", action="store_true", help="write the hashes of the pinned versions anew instead")
    arguments = parser.parse_args()
    if arguments.lock:
        for lock in sorted(LOCKS.glob("*.txt")):
            write_lock(lock)
        return
    platforms = list(PLATFORMS) if arguments.all else arguments.platforms or [this_platform()]
    for platform in platforms:
        check_platform(platform)
    for archive in build(platforms):
        if importlib.util.find_spec("bpy"):  # Blender's tool comes with it; a release has it
            validate(archive)
        report(archive)


def this_platform() -> str:
    """The platform of this machine, by Blender's names; there may be no zip for it."""
    system, processor = sys.platform, machine.machine().lower()
    return f"{SYSTEMS.get(system, system)}-{PROCESSORS.get(processor, processor)}"


def check_platform(platform: str) -> None:
    if platform in UNSUPPORTED:
        sys.exit(f"There is no zip for {platform}: {UNSUPPORTED[platform]}.")
    if platform not in PLATFORMS:
        sys.exit(f"There is no platform {platform}: choose from {', '.join(PLATFORMS)}.")


def build(platforms: Sequence[str], folder: Path = DIST) -> list[Path]:
    """Build the zips of some platforms into a folder.

    Raises:
        ValueError: a file is neither shipped nor excluded, or versions differ.
        OSError, CalledProcessError: a wheel cannot be downloaded.
    """
    manifest = (ADDON / MANIFEST).read_text(encoding="utf-8")
    fields = tomllib.loads(manifest)
    check_version(fields["version"])
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        core = build_core_wheel(Path(temporary))
        pages = built_pages(Path(temporary))
        archives = []
        for platform in platforms:
            wheels = {core.name: core}
            for python in PYTHONS:
                wheels |= {wheel.name: wheel for wheel in locked_wheels(python, platform)}
            content = shipped_files() | pages
            content[MANIFEST] = completed_manifest(manifest, platform, sorted(wheels)).encode()
            content |= {f"wheels/{name}": path.read_bytes() for name, path in wheels.items()}
            archive = folder / f"{fields['id']}-{fields['version']}-{platform}.zip"
            write_archive(archive, content)
            archives.append(archive)
    return archives


def check_version(version: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    if version != project:
        raise ValueError(f"{MANIFEST} says version {version}, pyproject.toml {project}: let them agree.")


def shipped_files() -> dict[str, bytes]:
    """Content of the add-on's files by their path in the zip; the licence is the project's."""
    every = {path for path in ADDON.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    shipped, left_out = (
        {path for pattern in patterns for path in ADDON.glob(pattern)} for patterns in (SHIPPED, NOT_SHIPPED)
    )
    if strays := every - shipped - left_out - {ADDON / MANIFEST}:
        names = ", ".join(sorted(str(path.relative_to(ROOT)) for path in strays))
        raise ValueError(f"Neither shipped nor left at home: {names}. Add a pattern to {Path(__file__).name}.")
    content = {path.relative_to(ADDON).as_posix(): path.read_bytes() for path in shipped}
    return content | {"LICENSE": (ROOT / "LICENSE").read_bytes()}


def completed_manifest(manifest: str, platform: str, wheels: Sequence[str]) -> str:
    """The manifest with platform and wheels, inserted before its first table."""
    listed = "".join(f'    "./wheels/{name}",\n' for name in wheels)
    lists = f'platforms = ["{platform}"]\nwheels = [\n{listed}]\n'
    head, table, tail = manifest.partition("\n[")
    return f"{head.rstrip()}\n\n{lists}{table}{tail}"


def write_archive(archive: Path, content: dict[str, bytes]) -> None:
    """Write a zip sorted by name and without dates; wheels are not compressed again."""
    with zipfile.ZipFile(archive, "w") as written:
        for name in sorted(content):
            entry = zipfile.ZipInfo(name, EPOCH_DATE)
            entry.create_system, entry.external_attr = 3, 0o100644 << 16
            entry.compress_type = zipfile.ZIP_STORED if name.endswith(".whl") else zipfile.ZIP_DEFLATED
            written.writestr(entry, content[name])


def build_core_wheel(folder: Path) -> Path:
    """Build the wheel of `zoomout_core` alone, without the adaptors, which an extension does not need."""
    source = folder / "source"
    for path in sorted(path for pattern in CORE for path in ROOT.glob(pattern)):
        copy = source / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
        copy.chmod(0o644)
    environment = build_environment(folder)
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, source, environment=environment)
    (wheel,) = folder.glob("*.whl")
    return wheel


def built_pages(folder: Path) -> dict[str, bytes]:
    """The documentation as HTML pages with pictures, by their path in the zip."""
    content = {}
    for name in DOCUMENTS:
        text = (DOCS / name).read_text(encoding="utf-8")
        options = ["--extension=tables", "--extension=fenced_code", "--extension=toc", "--encoding=utf-8"]
        run = [sys.executable, "-m", "markdown", *options]
        done = subprocess.run(run, input=text.encode(), env=build_environment(folder), check=True, capture_output=True)
        body = re.sub(r'href="(\w+)\.md', r'href="\1.html', done.stdout.decode())
        title = re.sub(r"^# (.*)", r"\1", text.splitlines()[0])
        content[f"docs/{Path(name).stem}.html"] = PAGE.format(title=title, body=body).encode()
        for picture in re.findall(r'src="([^"]+)"', body):
            content[f"docs/{picture}"] = (DOCS / picture).read_bytes()
    return content


def build_environment(folder: Path) -> dict[str, str]:
    """The environment variables of a process that builds with the pinned build tools."""
    backend = folder / "backend"
    if not backend.exists():
        pip("install", "--require-hashes", "--only-binary=:all:", "--target", backend, "-r", LOCKS / "build.txt")
    return {**os.environ, "PYTHONPATH": str(backend), "PYTHONUTF8": "1", "SOURCE_DATE_EPOCH": str(EPOCH)}


def locked_wheels(python: str, platform: str) -> list[Path]:
    """The wheels that a lock names for a platform, downloaded if they are missing."""
    lock = LOCKS / f"{python}.txt"
    folder = DOWNLOADS / python / platform
    hashes = set(re.findall(r"sha256:(\w+)", lock.read_text()))
    pins = requirements(lock)

    def present() -> list[Path]:
        return [wheel for wheel in sorted(folder.glob("*.whl")) if digest(wheel) in hashes]

    if len(present()) < len(pins):
        download(python, platform, folder, ["--require-hashes", "-r", lock])
    wheels = present()
    if len(wheels) != len(pins):
        raise ValueError(f"{folder} holds {len(wheels)} wheels for the {len(pins)} of {lock.name}: delete it.")
    return wheels


def download(python: str, platform: str, folder: Path, wanted: Sequence[str | Path]) -> None:
    """Download wheels for another Python and platform with pip."""
    tags = [f"--platform={tag}" for tag in PLATFORMS[platform]]
    abis = [f"--abi={abi}" for abi in (python, "abi3", "none")]
    versions = ["--implementation=cp", f"--python-version={python.removeprefix('cp')}"]
    pip("download", "--no-deps", "--only-binary=:all:", "--dest", folder, *versions, *abis, *tags, *wanted)


def write_lock(lock: Path) -> None:
    """Update the hashes of a lock's versions for every platform; the comment at its top is kept."""
    comment = "".join(line for line in lock.read_text().splitlines(keepends=True) if line.startswith("#"))
    pins = requirements(lock)
    hashes: dict[str, set[str]] = {pin: set() for pin in pins}
    for pin in pins:
        for platform in PLATFORMS:
            with tempfile.TemporaryDirectory() as folder:
                download(lock.stem if lock.stem in PYTHONS else PYTHONS[0], platform, Path(folder), [pin])
                hashes[pin] |= {digest(wheel) for wheel in Path(folder).glob("*.whl")}
    lines = [" \\\n".join([pin, *(f"    --hash=sha256:{one}" for one in sorted(hashes[pin]))]) for pin in pins]
    lock.write_text(comment + "".join(f"{line}\n" for line in lines))


def requirements(lock: Path) -> list[str]:
    """The requirements of a lock, such as `scipy==1.17.1`."""
    return re.findall(r"^[\w.-]+==[\w.]+", lock.read_text(), re.MULTILINE)


def pip(command: str, *arguments: str | Path, environment: dict[str, str] | None = None) -> None:
    run: list[str | Path] = [sys.executable, "-m", "pip", command, "--quiet", *arguments]
    subprocess.run(run, env=environment, umask=0o022, check=True)  # the built wheel records the modes of files


def digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def validate(archive: Path) -> None:
    """Validate a zip with Blender's own tool, with the tags of Blender's platform."""
    spec = importlib.util.find_spec("bpy")
    assert spec is not None
    assert spec.origin is not None
    (scripts,) = Path(spec.origin).parent.glob("*/scripts")
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    tags = scripts / "modules" / "_bpy_internal" / "extensions" / "tags.py"
    command = [sys.executable, str(tool), "validate", f"--valid-tags={tags}", str(archive)]
    judged = subprocess.run(command, capture_output=True, text=True)
    if judged.returncode != 0:
        sys.exit(f"Blender refuses {archive.name}:\n{judged.stdout}{judged.stderr}")


def report(archive: Path) -> None:
    print(f"{archive.relative_to(ROOT)}: {archive.stat().st_size / 1e6:.1f} MB, sha256 {digest(archive)}")
    with zipfile.ZipFile(archive) as opened:
        wheels = [entry for entry in opened.infolist() if entry.filename.endswith(".whl")]
        for entry in wheels:
            print(f"    {entry.file_size / 1e6:5.1f} MB  {Path(entry.filename).name}")
        print(f"    {len(opened.namelist()) - len(wheels)} other files")


if __name__ == "__main__":
    try:
        main()
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        sys.exit(f"The extension was not built: {error}")
