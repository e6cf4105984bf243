# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the released files, and check each of them in an empty environment.

`make release` writes the wheel, the source distribution and the extension's zips of the last commit to `dist`.
`make release PROJECT_URL=https://…` sets the project's public address, which is stored nowhere: the README's relative
links and pictures become absolute, as a package index requires, and the metadata include it.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parent.parent
DIST = ROOT / "dist"
BUILD = ROOT / "build" / "release"

# Addresses of a version's file: as a page, and raw.
FILE, RAW = "{url}/blob/v{version}/{path}", "{url}/raw/v{version}/{path}"
# An inline link, or a picture if it begins with an exclamation mark.
LINK = re.compile(r"(!?)\[([^]]*)\]\(([^)\s]+)\)")
# The top-level packages of the wheel.
PACKAGES = {"zoomout_core", "meshlab_filter"}


def main() -> None:
    """Build and check, with the command line's arguments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without-extension", action="store_true", help="neither build nor check the zips")
    parser.add_argument("--tests", default="tests/core", help="what of the tests runs from the source distribution")
    arguments = parser.parse_args()
    url = os.environ.get("PROJECT_URL", "").rstrip("/")
    shutil.rmtree(BUILD, ignore_errors=True)
    tree, version = export(url)
    for old in (*DIST.glob("zoomout_core-*"), *([] if arguments.without_extension else DIST.glob("*.zip"))):
        old.unlink()
    run(sys.executable, "-m", "build", "--outdir", str(DIST), str(tree))
    wheel, source = DIST / f"zoomout_core-{version}-py3-none-any.whl", DIST / f"zoomout_core-{version}.tar.gz"
    run(sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(source))
    check_readme(wheel, url)
    check_bare(wheel)
    check_commands(wheel)
    check_source(source, arguments.tests)
    if not arguments.without_extension:
        run(sys.executable, "tools/extension.py", "--all")
        run(sys.executable, "tools/blender_versions.py", "--ends")
    print("release:", *(path.name for path in sorted(DIST.iterdir()) if path.is_file()))


def export(url: str) -> tuple[Path, str]:
    """Export the last commit's tree to a folder, with the project's address; return it and the version."""
    if run("git", "status", "--porcelain", "--untracked-files=no").strip():
        print("release: what is not committed is left out")
    tree = BUILD / "tree"
    tree.mkdir(parents=True)
    archive = BUILD / "tree.tar"
    run("git", "archive", "--output", str(archive), "HEAD")
    with tarfile.open(archive) as packed:
        packed.extractall(tree, filter="data")
    settings, readme = tree / "pyproject.toml", tree / "README.md"
    version: str = tomllib.loads(settings.read_text(encoding="utf-8"))["project"]["version"]
    if url:
        settings.write_text(with_addresses(settings.read_text(encoding="utf-8"), url), encoding="utf-8")
        readme.write_text(with_absolute_links(readme.read_text(encoding="utf-8"), url, version), encoding="utf-8")
    return tree, version


def with_addresses(settings: str, url: str) -> str:
    """The text of pyproject.toml, with addresses for the metadata."""
    pages = {
        "Homepage": url,
        "Documentation": f"{url}/tree/HEAD/docs",
        "Changelog": f"{url}/blob/HEAD/CHANGELOG.md",
        "Issues": f"{url}/issues",
    }
    lines = "".join(f'{name} = "{page}"\n' for name, page in pages.items())
    return settings.replace("[project.scripts]\n", f"[project.urls]\n{lines}\n[project.scripts]\n", 1)


def with_absolute_links(text: str, url: str, version: str) -> str:
    """Replace relative links and pictures of a Markdown text by the project's address."""

    def absolute(link: re.Match[str]) -> str:
        mark, label, target = link.groups()
        if is_absolute(target):
            return link[0]
        place = (RAW if mark else FILE).format(url=url, version=version, path=target)
        return f"{mark}[{label}]({place})"

    return LINK.sub(absolute, text)


def is_absolute(target: str) -> bool:
    """Whether a link is absolute."""
    return re.match(r"[a-z]+:|#", target) is not None


def check_readme(wheel: Path, url: str) -> None:
    """Check that the README's links work on a package index; without an address, print that they do not."""
    with ZipFile(wheel) as packed:
        (name,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        readme = packed.read(name).decode().partition("\n\n")[2]  # below the headers
    relative = [target for _, _, target in LINK.findall(readme) if not is_absolute(target)]
    if relative and url:
        sys.exit(f"The README's links to {', '.join(relative)} are relative: a package index cannot follow them.")
    if relative:
        print(
            f"release: {len(relative)} links and pictures of the README are relative and lead nowhere on a package "
            "index: give PROJECT_URL=https://…, the project's address."
        )


def check_bare(wheel: Path) -> None:
    """Check the wheel without extras: it can be imported, and each command prints one sentence that names its extra."""
    python = fresh("bare", str(wheel))
    run(str(python), "-c", "import zoomout_core as zo; zo.match, zo.Surface, zo.transfer")
    for module, extra in (("zoomout_core", "cli"), ("meshlab_filter", "meshlab")):
        done = subprocess.run([python, "-m", module, "--help"], capture_output=True, text=True, check=False, cwd=BUILD)
        if done.returncode != 1 or not re.fullmatch(rf"[^\n]* pip install '\.\[{extra}\]'\.\n", done.stderr):
            sys.exit(f"python -m {module} without its extra says: {done.stderr}")
    (installed,) = python.parents[1].glob("lib/python3*/site-packages/zoomout_core-*.dist-info/RECORD")
    top = {line.split(",")[0].split("/")[0] for line in installed.read_text(encoding="utf-8").splitlines()}
    odd = {name for name in top if name != ".." and not name.endswith(".dist-info")} - PACKAGES
    if odd:
        sys.exit(f"The wheel puts {', '.join(sorted(odd))} at top level.")


def check_commands(wheel: Path) -> None:
    """Check the wheel with the extra `cli`: match samples, and transfer to a file."""
    python = fresh("cli", f"{wheel}[cli]")
    zoomout = [str(python.parent / "zoomout")]
    folder = BUILD / "try"
    source, target = str(folder / "character.glb"), str(folder / "scan.ply")
    run(*zoomout, "sample", str(folder))
    run(*zoomout, "match", source, target, "-o", str(folder / "map.npz"), "--cache", "off")
    run(*zoomout, "transfer", source, target, "-o", str(folder / "scan.glb"), "--cache", "off")
    if "Wave" not in run(*zoomout, "info", str(folder / "scan.glb")):
        sys.exit("The animation did not come along.")


def check_source(source: Path, tests: str) -> None:
    """Check the source distribution by running its own tests."""
    with tarfile.open(source) as packed:
        packed.extractall(BUILD, filter="data")
    tree = BUILD / source.name.removesuffix(".tar.gz")
    python = fresh("source", f"{tree}[core-tests]")
    # The tests run outside of the tree, so that they test the installed package.
    run(str(python), "-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile", *tests.split(), folder=tree)


def fresh(name: str, wanted: str) -> Path:
    """Create an environment with one package and its dependencies, and return its Python."""
    place = BUILD / name
    venv.create(place, symlinks=True, with_pip=True)
    python = place / "bin" / "python"
    run(str(python), "-m", "pip", "install", "--quiet", "--prefer-binary", wanted)
    return python


def run(*command: str, folder: Path = ROOT) -> str:
    """Run a command and return its output; exit if it fails."""
    print("release:", *(word.replace(f"{ROOT}/", "") for word in command), flush=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        sys.exit(f"{done.stdout}\nThis failed, so there is nothing to release: {' '.join(command)}")
    return done.stdout


if __name__ == "__main__":
    main()
