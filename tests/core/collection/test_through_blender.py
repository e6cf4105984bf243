# SPDX-License-Identifier: GPL-3.0-or-later
"""A collection calls Blender, here a stand-in program, only for files that it has not converted yet."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from creatures import creature

from zoomout_core.assets.files import read_asset
from zoomout_core.cli import main
from zoomout_core.collection.through_blender import transfer_pair_through_blender
from zoomout_core.collection.transfer_records import PairTransfer
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats import blender_files
from zoomout_core.mesh.formats.blender_files import blender_command
from zoomout_core.mesh.formats.files import read_surface, write_shape

pytestmark = pytest.mark.usefixtures("few_candidates")

# This stand-in reads PLY files with other suffixes. Like Blender, it also prints unrelated lines.
STAND_IN = """#!{python}
import json, shutil, sys
from pathlib import Path

arguments = sys.argv[sys.argv.index("zoomout") + 1:]
value_of = dict(zip(arguments, arguments[1:]))
with (Path(__file__).parent / "calls.txt").open("a") as calls:
    calls.write(json.dumps(arguments) + chr(10))
print("Read something")
command, file = arguments[:2]
report = {{"targets": {{}}}}
if "silent" in file:
    sys.exit(11)
if "broken" in file:
    report = {{"error": "It is broken."}}
elif command == "surface":
    shutil.copy(file, value_of["--save"])
else:
    assert Path(value_of["--map"]).is_file()
    if "naked" in arguments[2]:
        report["targets"] = {{"Body": {{"error": "It is naked."}}}}
    else:
        Path(value_of["--save"]).write_text("carried")
        body = {{"notes": ["All is well.", "It tears."], "warnings": ["It tears."]}}
        report["targets"] = {{"Body": body, "Eye": {{"error": "It has none."}}}}
Path(value_of["--report"]).write_text(json.dumps(report))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    place = tmp_path / "program" / "blender"
    place.parent.mkdir()
    place.write_text(STAND_IN.format(python=sys.executable))
    place.chmod(0o755)
    return place


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A template, targets of several formats, and a broken target."""
    place = tmp_path / "shapes"
    place.mkdir()
    for number, name in enumerate(("hero.blend", "scan.fbx", "other.ply", "last.off", "naked.blend")):
        made = creature(300, seed=1, bend=0.1 * number, asymmetry=0.3).surface
        write_shape(made, place / "made.ply")
        text = (place / "made.ply").read_text()
        if name.endswith(".off"):
            rows = text.split("end_header\n")[1]
            text = f"OFF\n{len(made.vertices)} {len(made.triangles)} 0\n{rows}"
        (place / name).write_text(text)
    (place / "made.ply").unlink()
    (place / "broken.blend").write_text("no mesh")
    return place


def calls(program: Path) -> list[list[str]]:
    place = program.parent / "calls.txt"
    lines = place.read_text().splitlines() if place.exists() else []
    place.unlink(missing_ok=True)
    return [json.loads(line) for line in lines]


def run(folder: Path, output: Path, *more: object) -> tuple[int, str]:
    line = [
        "collection",
        folder,
        "-o",
        output,
        "--detail",
        "fast",
        "--workers",
        1,
        "--no-pictures",
        "--no-agree",
        *more,
    ]
    done = CliRunner().invoke(main, [str(each) for each in line])
    return done.exit_code, done.output


def test_blender_reads_and_transfers_once_and_failing_files_fail_alone(
    program: Path, folder: Path, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    more = ["--template", folder / "hero.blend", "--transfer", "--blender", program, "--kinds", "uv,weights"]
    more += ["--move-rig"]
    status, _ = run(folder, output, *more)
    assert status == 3
    asked = calls(program)
    roles = {Path(each[1]).name: each[3] for each in asked if each[0] == "surface"}
    # Formats that Blender cannot import are read here and passed on as PLY.
    assert roles == dict.fromkeys(("broken.blend", "naked.blend", "other.ply", "scan.fbx"), "target") | {
        "hero.blend": "source"
    }
    carried = [each for each in asked if each[0] == "carry"]
    assert all(each[1] == str(folder / "hero.blend") for each in carried)
    targets = {Path(each[2]).name[:5]: each for each in carried}
    assert set(targets) == {"scan.", "other", "naked", "last-"}
    assert Path(targets["last-"][2]).suffix == ".ply"
    line = " ".join(targets["scan."])
    assert "--data uv_maps vertex_groups --bind --replace-binding --move-rig" in line
    made = {path.name for path in (output / "meshes").iterdir()}
    assert made == {"scan.blend", "other.blend", "last.blend"}
    report = json.loads((output / "report.json").read_text())
    assert report["failures"] == {"broken": "It is broken.", "transfer to naked": "It is naked."}
    warnings = ["It tears.", "'Eye' received no data: It has none."]
    notes = ["All is well.", *warnings]
    assert report["transferred"] == dict.fromkeys(("scan", "other", "last"), notes)
    assert report["transfer_warnings"] == dict.fromkeys(("scan", "other", "last"), warnings)

    # A second run retries only the files that failed.
    assert run(folder, output, *more)[0] == 3
    assert sorted(Path(each[1 if each[0] == "surface" else 2]).name for each in calls(program)) == [
        "broken.blend",
        "naked.blend",
    ]
    again = json.loads((output / "report.json").read_text())
    assert [again[each] for each in ("transferred", "transfer_warnings")] == [
        report[each] for each in ("transferred", "transfer_warnings")
    ]

    # Changed or lost files are rebuilt, and all files on demand.
    write_shape(creature(300, seed=1, bend=0.7, asymmetry=0.3).surface, folder / "made.ply")
    (folder / "made.ply").replace(folder / "scan.fbx")
    (output / "meshes" / "other.blend").unlink()
    (folder / "broken.blend").unlink()
    (folder / "naked.blend").unlink()
    assert run(folder, output, *more)[0] == 0
    assert sorted((each[0], Path(each[1 if each[0] == "surface" else 2]).name) for each in calls(program)) == [
        ("carry", "other.ply"),
        ("carry", "scan.fbx"),
        ("surface", "scan.fbx"),
    ]
    assert len(list((output / "surfaces").glob("scan-*.ply"))) == 1
    assert run(folder, output, *more, "--restart")[0] == 0
    assert len(calls(program)) == 6


def test_transfer_that_ends_early_has_no_record(program: Path, folder: Path, tmp_path: Path) -> None:
    record, map_file = tmp_path / "naked.json", tmp_path / "map.npz"
    record.write_text("that of an earlier transfer with other options")
    map_file.touch()
    paths = folder / "hero.blend", folder / "naked.blend", map_file, tmp_path / "made.blend"
    with pytest.raises(MeshError, match="It is naked"):
        transfer_pair_through_blender(PairTransfer(*paths, ("uv",), record), str(program))
    assert not record.exists()


@pytest.mark.slow
def test_format_is_that_of_the_template_by_default(program: Path, folder: Path, tmp_path: Path) -> None:
    for name in ("broken.blend", "naked.blend", "last.off"):
        (folder / name).unlink()
    more = "--transfer", "--blender", program, "--template"
    assert run(folder, tmp_path / "fbx", *more, folder / "scan.fbx")[0] == 0
    assert {path.suffix for path in (tmp_path / "fbx" / "meshes").iterdir()} == {".fbx"}
    (folder / "hero.blend").unlink()
    (folder / "scan.fbx").replace(folder / "scan.ply")
    assert run(folder, tmp_path / "blend", *more, folder / "scan.ply", "--format", "blend")[0] == 0
    assert {path.suffix for path in (tmp_path / "blend" / "meshes").iterdir()} == {".blend"}


def test_blender_is_not_started_if_no_file_needs_it(program: Path, folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        if path.suffix in (".blend", ".fbx"):
            path.unlink()
    assert run(folder, tmp_path / "out", "--blender", program, "--template", folder / "other.ply")[0] == 0
    assert not calls(program)
    assert not (tmp_path / "out" / "surfaces").exists()


def test_without_blender_its_files_fail_and_a_template_is_refused(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blender_files, "extension_module", lambda _: None)
    monkeypatch.setattr(blender_files.shutil, "which", lambda _: None)
    monkeypatch.delenv(blender_files.PROGRAM, raising=False)
    status, said = run(folder, tmp_path / "out", "--template", folder / "hero.blend", "--transfer")
    assert (status, "requires Blender" in said) == (1, True)
    assert not (tmp_path / "out").exists()
    status, _ = run(folder, tmp_path / "out", "--template", folder / "other.ply")
    assert status == 3
    failures = json.loads((tmp_path / "out" / "report.json").read_text())["failures"]
    assert set(failures) == {"broken", "hero", "naked", "scan"}
    assert "install Blender 4.2" in failures["scan"]
    with pytest.raises(MeshError, match="There is no program nowhere"):
        blender_command("nowhere")


def test_given_program_precedes_the_environment_variable(
    program: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(blender_files.PROGRAM, str(program))
    assert blender_command()[0] == str(program)
    assert blender_command(sys.executable)[0] == sys.executable
    # With the program set, all readers accept these files.
    assert len(read_surface(folder / "hero.blend").vertices) == 300
    assert len(read_asset(folder / "scan.fbx").surface.vertices) == 300
    with pytest.raises(MeshError, match=r"broken\.blend: It is broken\.$"):
        read_surface(folder / "broken.blend")


def test_crash_or_hang_of_blender_is_reported(program: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(blender_files.PROGRAM, str(program))
    (folder / "hero.blend").rename(folder / "silent.blend")
    with pytest.raises(
        MeshError, match=r"exited with status 11 .* saying: Read something: check that it is Blender 4\.2"
    ):
        read_surface(folder / "silent.blend")
    program.write_text(f"#!{sys.executable}\nimport os\nos.kill(os.getpid(), 9)\n")
    with pytest.raises(ChildProcessError, match="terminated by signal 9: it may need more memory"):
        blender_files.run_blender(["surface", "any"])
    monkeypatch.setattr(blender_files, "MAX_SECONDS", 0.3)
    program.write_text(f"#!{sys.executable}\nimport time\ntime.sleep(60)\n")
    with pytest.raises(MeshError, match="Blender took more than"):
        read_surface(folder / "scan.fbx")
