# SPDX-License-Identifier: GPL-3.0-or-later
"""No process of this project imports a module that is in the user's folder, or listens beyond this machine."""

from __future__ import annotations

import os
import re
import socket
import ssl
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

import psutil
import pytest
from creatures import creature

import zoomout_core
from zoomout_core.collection import dask_engine
from zoomout_core.collection.dask_engine import OnDask, check_open_files, check_working_folder, local_engine
from zoomout_core.collection.engine import Task
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats import blender_files
from zoomout_core.mesh.formats.blender_files import PROGRAM, blender_command
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.runtime.child_process import SAFE_PATH, child_environment, leave_out_working_folder

REPOSITORY = Path(zoomout_core.__file__).parents[1]
# Modules that the processes import: of packages, and of Python's library.
PACKAGES = ("bpy", "click", "dask", "distributed", "numpy", "pymeshlab", "scipy", "tqdm", "trimesh")
LIBRARY = ("json", "multiprocessing", "pickle", "random", "selectors", "socket", "subprocess", "tempfile", "uuid")
# Calls that start a process, and their number in the files; each has a test below.
STARTING = re.compile(
    r"subprocess\.(run|Popen|call|check_\w+)\(|LocalCluster\(|ProcessPool|os\.(system|exec|spawn|fork)"
)
KNOWN = {
    "zoomout_core/mesh/formats/blender_files.py": 1,
    "zoomout_core/collection/dask_engine.py": 1,
    "meshlab_filter/trial.py": 1,
}
TRIAL = """
import sys
sys.path = [place for place in sys.path if place]  # of the process here, not of the one that it starts
from meshlab_filter.trial import fault_of_file
assert fault_of_file({path!r}, False) == ""
"""


def plant(folder: Path, names: tuple[str, ...]) -> tuple[Path, Path]:
    """A folder with modules that must not be imported, and the file that they write their names to if they are."""
    here, mark = folder / "downloads", folder / "mark"
    here.mkdir()
    for name in names:
        (here / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write('{name} ')\nraise SystemExit(99)\n")
    return here, mark


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The mark of the modules of a folder that the user is in."""
    here, mark = plant(tmp_path, PACKAGES + LIBRARY)
    monkeypatch.chdir(here)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}{REPOSITORY}{os.pathsep}")  # whose empty entries are that folder
    return mark


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    path = tmp_path / "mesh.ply"
    write_shape(creature(200).surface, path)
    return path


def test_the_places_that_start_processes_are_known() -> None:
    found = {
        path.relative_to(REPOSITORY).as_posix(): len(STARTING.findall(path.read_text(encoding="utf-8")))
        for package in ("zoomout_core", "meshlab_filter", "blender_addon")
        for path in sorted((REPOSITORY / package).rglob("*.py"))
    }
    assert {path: count for path, count in found.items() if count} == KNOWN


@pytest.mark.parametrize("name", ["numpy", "tempfile"])
def test_python_itself_imports_from_the_folder(name: str, planted: Path) -> None:
    """Otherwise the other tests could not fail."""
    subprocess.run([sys.executable, "-c", f"import {name}"], check=False)
    assert planted.read_text().split()[0] == name


# --- each process imports nothing from the user's folder -----------------------------------------------------


def test_blender_module_imports_nothing_from_working_folder(planted: Path, mesh: Path, tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    blender_files.write_surface(mesh, tmp_path / "made.ply")
    assert (tmp_path / "made.ply").exists()
    assert not planted.exists()


@pytest.mark.skipif(os.name != "posix", reason="the program is a script")
def test_blender_as_a_program_starts_in_an_empty_folder(
    planted: Path, mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = tmp_path / "said"
    program = tmp_path / "blender"
    program.write_text(f"#!/bin/sh\n(pwd; ls; echo $PYTHONPATH; echo $@) > '{said}'\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setenv(PROGRAM, os.path.relpath(program))
    with pytest.raises(MeshError, match="exited with status 3"):
        blender_files.write_surface(Path(os.path.relpath(mesh)), Path("made.ply"))
    folder, *files, path, arguments = said.read_text().splitlines()
    assert Path(folder) != Path.cwd()
    assert files == ["output.txt"]
    assert "" not in path.split(os.pathsep)
    assert "--disable-autoexec --command zoomout" in arguments
    assert all(Path(word).is_absolute() for word in arguments.split() if word.endswith((".ply", ".json")))


def test_file_trial_imports_nothing_from_working_folder(planted: Path, mesh: Path) -> None:
    pytest.importorskip("pymeshlab")
    outer = [sys.executable, "-c", TRIAL.format(path=os.path.relpath(mesh))]
    ran = subprocess.run(outer, env=os.environ | {"PYTHONPATH": str(REPOSITORY)}, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert not planted.exists()


@pytest.mark.slow
def test_collection_workers_import_nothing_from_working_folder(planted: Path) -> None:
    before = dict(os.environ)
    with local_engine(2, 0) as engine:
        (done,) = engine.as_completed([Task("folder", os.getcwd, ())])
    assert done.result == os.getcwd()
    assert not planted.exists()
    assert dict(os.environ) == before


@pytest.mark.parametrize("module", ["zoomout_core", "meshlab_filter"])
def test_commands_as_modules_import_no_packages_from_working_folder(module: str, tmp_path: Path, mesh: Path) -> None:
    """`python -m` searches there first, so modules of Python's library cannot be protected; see SECURITY.md."""
    here, mark = plant(tmp_path, PACKAGES)
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    command = [sys.executable, "-m", module, *(["info", str(mesh)] if module == "zoomout_core" else ["list"])]
    ran = subprocess.run(command, cwd=here, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert not mark.exists()


@pytest.mark.skipif(not (Path(sys.executable).parent / "zoomout").exists(), reason="it is not installed")
def test_console_script_imports_nothing_from_working_folder(planted: Path, mesh: Path) -> None:
    script = Path(sys.executable).parent / "zoomout"
    ran = subprocess.run([script, "info", mesh], env=os.environ | {"PYTHONPATH": ""}, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert not planted.exists()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("kind", ["settings", "pipe"])
def test_matplotlib_settings_in_working_folder_are_ignored(kind: str, mesh: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    here = tmp_path / "downloads"
    here.mkdir()
    if kind == "settings":
        (here / "matplotlibrc").write_text("savefig.dpi: 7\n")
    elif hasattr(os, "mkfifo"):
        os.mkfifo(here / "matplotlibrc")
    code = f"""
import numpy as np
import zoomout_core as zo
from zoomout_core.collection.pictures import _draw
surface = zo.read_surface({str(mesh)!r})
assert _draw(surface, np.ones((len(surface.vertices), 3)))
import matplotlib, os
assert matplotlib.rcParams["savefig.dpi"] != 7
assert os.getcwd() == {str(here)!r}
"""
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    ran = subprocess.run([sys.executable, "-c", code], cwd=here, env=environment, capture_output=True, timeout=60)
    assert ran.returncode == 0, ran.stderr


# --- what they have in common --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("", []),
        (os.pathsep, []),
        (f"{os.pathsep}/packages", ["/packages"]),
        (f"/packages{os.pathsep}", ["/packages"]),
        (f"/one{os.pathsep}{os.pathsep}/two", ["/one", "/two"]),
    ],
)
def test_empty_entries_of_the_path_are_dropped(given: str, kept: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", given)
    assert child_environment(["/first"])["PYTHONPATH"].split(os.pathsep) == ["/first", *kept]
    assert child_environment()["PYTHONPATH"] == os.pathsep.join(kept)
    assert child_environment()[SAFE_PATH] == "1"


def test_pythonpath_folders_of_the_user_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", "mine")
    assert child_environment()["PYTHONPATH"] == str(tmp_path / "mine")


@pytest.mark.parametrize("first", ["", "."])
def test_working_folder_is_removed_from_sys_path(first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [first, "/packages"])
    leave_out_working_folder()
    assert sys.path == ["/packages"]


@pytest.mark.parametrize("path", [[], ["/packages"], [str(REPOSITORY), "/packages"]])
def test_other_folders_stay_in_sys_path(path: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)  # from which this package is imported
    monkeypatch.setattr(sys, "path", list(path))
    leave_out_working_folder()
    assert sys.path == path


@pytest.mark.skipif(os.name != "posix", reason="programs are others there")
@pytest.mark.parametrize("place", [".", ""])
def test_program_in_working_folder_is_not_used_as_blender(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "blender"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", place)  # as Windows does by itself
    monkeypatch.delenv(PROGRAM, raising=False)
    monkeypatch.setattr(blender_files, "extension_module", lambda _: None)
    with pytest.raises(MeshError, match="requires Blender"):
        blender_command()
    assert blender_command("./blender")[0] == str(program)  # named by the user


@pytest.mark.parametrize("name", ["socket.py", "struct.cpython-310-x86_64-linux-gnu.so", "json"])
def test_old_python_refuses_folder_with_shadowing_modules(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dask_engine, "SAFE_PATH_SINCE", (9, 9))
    (tmp_path / "numpy.py").touch()
    (tmp_path / "notes.txt").touch()
    check_working_folder()
    (tmp_path / name).mkdir() if name == "json" else (tmp_path / name).touch()
    with pytest.raises(OSError, match=f"{name} in the current folder would replace a module of Python"):
        check_working_folder()


# --- who can reach them --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def listening() -> Iterator[list[tuple[str, int]]]:
    """Addresses at which the processes of a collection listen."""
    with local_engine(2, 0) as engine:
        assert isinstance(engine, OnDask)
        own = psutil.Process()
        processes = [own, *own.children(recursive=True)]
        assert len(processes) > 2
        sockets = [each for process in processes for each in process.net_connections("all")]
        yield [(each.laddr.ip, each.laddr.port) for each in sockets if each.status == psutil.CONN_LISTEN]


def status_of(url: str) -> int | None:
    """How an HTTP server answers; None if it closes the connection."""
    try:
        return int(urlopen(url, timeout=10).status)
    except HTTPError as error:
        return error.code
    except ConnectionError:
        return None


def test_nothing_listens_beyond_this_machine(listening: list[tuple[str, int]]) -> None:
    assert len(listening) > 3
    assert {host for host, _ in listening} == {"127.0.0.1"}


@pytest.mark.parametrize("page", ["", "status", "health", "metrics", "info/main/workers.html", "json/counts.json"])
def test_servers_have_no_pages(page: str, listening: list[tuple[str, int]]) -> None:
    assert {status_of(f"http://{host}:{port}/{page}") for host, port in listening} == {None, 404}


def test_client_without_certificate_is_refused(listening: list[tuple[str, int]]) -> None:
    anyone = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE
    encrypted = [(host, port) for host, port in listening if status_of(f"http://{host}:{port}") is None]
    assert len(encrypted) >= 3  # of the scheduler, and of each worker
    for address in encrypted:
        with (
            socket.create_connection(address, timeout=10) as plain,
            pytest.raises(ssl.SSLError, match=r"(?i)certificate required|handshake failure"),
            anyone.wrap_socket(plain) as wrapped,
        ):
            wrapped.recv(1)


def open_files(soft: int) -> Callable[[], None]:
    """Limit the files that a process may open; the second limit, to which it may raise the first, stays if higher."""
    resource = pytest.importorskip("resource")
    return lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (soft, soft))


def test_workers_without_enough_open_files_are_refused(mesh: Path, tmp_path: Path) -> None:
    other = mesh.with_name("other.ply")
    write_shape(creature(200, seed=1).surface, other)
    command = [
        sys.executable,
        "-m",
        "zoomout_core",
        "collection",
        mesh,
        other,
        "-o",
        tmp_path / "out",
        "--workers",
        "2",
    ]
    ran = subprocess.run(
        command, env=child_environment([REPOSITORY]), capture_output=True, text=True, preexec_fn=open_files(20)
    )
    assert ran.returncode == 1
    (line,) = ran.stderr.splitlines()
    assert re.fullmatch(
        r"Error: 2 workers need \d+ open files, but this shell allows 20: raise the limit \(ulimit -n\), or use "
        r"--workers 1\.",
        line,
    )


def test_open_file_limit_is_raised_if_allowed() -> None:
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (120, hard))
        check_open_files(8)
        raised = resource.getrlimit(resource.RLIMIT_NOFILE)
        assert raised[0] > 120
        check_open_files(2)
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == raised
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_failed_start_of_workers_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import distributed

    def fail(**_: object) -> None:
        raise RuntimeError("Nanny failed to start.")

    monkeypatch.setattr(distributed, "LocalCluster", fail)
    sentence = r"^The processes could not be started \(Nanny failed to start\.\): free memory"
    with pytest.raises(OSError, match=sentence), local_engine(2, 0):
        pass


def test_a_command_in_a_folder_that_was_deleted_works(mesh: Path, tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    script = "import os, sys; os.rmdir(os.getcwd()); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    command = [sys.executable, "-c", script, "-m", "zoomout_core", "info", str(mesh)]
    ran = subprocess.run(command, cwd=gone, env=os.environ | {"PYTHONPATH": str(REPOSITORY)}, capture_output=True)
    assert ran.returncode == 0, ran.stderr


def test_command_works_with_closed_standard_error(mesh: Path, tmp_path: Path) -> None:
    script = "import os, sys; os.close(2); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    arguments = ["match", str(mesh), str(mesh), "-o", str(tmp_path / "map.npz"), "--initial", "nearest"]
    command = [sys.executable, "-c", script, "-m", "zoomout_core", *arguments]
    ran = subprocess.run(command, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(REPOSITORY)}, capture_output=True)
    assert ran.returncode == 0, ran.stdout
    assert (tmp_path / "map.npz").exists()


def test_invalid_tqdm_setting_is_one_sentence(mesh: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY), "TQDM_MININTERVAL": "often"}
    command = [sys.executable, "-m", "zoomout_core", "match", str(mesh), str(mesh)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert ran.returncode == 2
    assert ran.stderr.splitlines()[-1].startswith("Error: An environment variable that begins with TQDM_")


def test_missing_scheduler_is_reported_at_once() -> None:
    before = set(threading.enumerate())
    with (
        pytest.raises(ConnectionError, match="There is no scheduler at nonsense"),
        dask_engine.remote_engine("nonsense", 0),
    ):
        pass
    assert set(threading.enumerate()) <= before
