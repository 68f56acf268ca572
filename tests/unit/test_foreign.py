"""What others give: files that never end or expand, texts that a terminal obeys, names that lead elsewhere."""

from __future__ import annotations

import ast
import json
import os
from pathlib import Path

import h5py
import numpy as np
import pytest

from robodyn_cli.errors import ResultFileError, SceneError
from robodyn_cli.foreign import contents, file_stem, opened, printable, spreadsheet_cell
from robodyn_cli.results.export import KINDS, export
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.hdf5.reader import ROOM, read_table
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import read_summary
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.mesh.files import MOST_NODES, MeshError, can_read_dae, read_dae, small_mesh
from tests.source import PACKAGE, files, nodes

pytestmark = pytest.mark.usefixtures("source_trees")
# Modules that open files by themselves: their own, or such as they have looked at. The list may only shrink.
OPENERS = {
    "foreign.py", "kernels/cache.py", "cli/console.py", "cli/interrupts.py", "results/atomic.py", "results/export.py",
    "results/hdf5/low.py", "results/hdf5/reader.py", "results/summary.py",
    "motion/going_on.py", "over/export/mcap.py", "over/study/rows.py", "kernels/compiler.py", "robots/collection.py",
    "robots/examples.py", "kernels/as_c/words.py",    "report/page/page.py", "version.py",
}  # fmt: skip


WORDS = ("open", "File", "read_text", "read_bytes")


def _opens(node: ast.Call) -> bool:
    if getattr(node.func, "attr", getattr(node.func, "id", "")) not in WORDS:
        return False
    name = ast.unparse(node.func)
    return name in ("open", "os.open", "h5py.File") or name.endswith((".read_text", ".read_bytes"))


def test_files_of_others_are_opened_in_one_place() -> None:
    found = {
        path.relative_to(PACKAGE).as_posix()
        for path in files()
        if any(word in path.read_text(encoding="utf-8") for word in WORDS)
        and any(_opens(node) for node in nodes(path, ast.Call))
    }
    assert found == OPENERS


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with a name")
def test_a_pipe_is_refused_by_every_reader(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.stl"
    os.mkfifo(pipe)
    for reader in (opened, lambda path: contents(path, 10)):
        with pytest.raises(OSError, match="a pipe or a device"):
            reader(pipe)
    with pytest.raises(MeshError, match="a pipe or a device"):
        small_mesh(str(pipe))
    with pytest.raises(SceneError, match="a pipe or a device"):
        load_scene(pipe)
    for reader in (read, lambda path: read_table(str(path))):
        with pytest.raises(ResultFileError, match="a pipe or a device"):
            reader(pipe)
    assert read_summary(pipe) == {}


def test_a_file_larger_than_allowed_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "large"
    file.write_bytes(b"x" * 11)
    assert len(contents(file, 11)) == 11
    with pytest.raises(OSError, match="larger than"):
        contents(file, 10)


def test_json_nested_without_end_is_no_summary(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("[" * 100_000)
    assert read_summary(tmp_path / "summary.json") == {}


@pytest.mark.parametrize("code", [0x00, 0x07, 0x0D, 0x1B, 0x7F, 0x9B, 0x200B, 0x202E, 0x2066, 0x2028, 0xFEFF])
def test_what_a_terminal_obeys_is_escaped_and_stays_json(code: int) -> None:
    text = f"a{chr(code)}\tb\n"
    assert printable(text) == f"a\\u{code:04x}\tb\n"
    assert json.loads(printable(json.dumps(text, ensure_ascii=False))) == text


def test_letters_stay() -> None:
    text = "Drehmoment θ₁, 関節, مفصل, 👩‍🔧"
    assert printable(text) == text


# -- results ---------------------------------------------------------------------------------------------
@pytest.fixture
def stored(tmp_path: Path) -> Path:
    result = Result("simulate", "t", "ok", "", events=[{"time": 0.0, "name": "@a", "kind": "=b"}])
    result.add("time", np.arange(3.0), dims=("time",), units="s", long_name="time")
    result.add("q", np.zeros((3, 1)), dims=("time", "joint"), units="rad", long_name="q", names=("a",))
    path = tmp_path / "result.h5"
    write(result, path)
    return path


def test_a_dimension_of_a_foreign_result_names_a_file_in_the_directory(stored: Path, tmp_path: Path) -> None:
    with h5py.File(stored, "r+") as file:
        for name in ("up/.x/scale", "of/events", "..\\..\\y"):
            scale = file.create_dataset(name, data=np.arange(4.0))
            scale.make_scale(name)
            file.create_dataset(f"of {name[:2]}", data=np.arange(4.0)).dims[0].attach_scale(scale)
        file.create_dataset("=1+1", data=np.arange(3.0)).dims[0].attach_scale(file["time"])
    if os.name != "posix":
        pytest.skip("names of files differ")
    for kind in sorted(KINDS.keys() - {"parquet"}):
        paths = export(read(stored), kind, tmp_path / "out" / kind)
        assert len(set(paths)) == len(paths) and {path.parent for path in paths} == {tmp_path / "out" / kind}
        assert {path.name for path in (tmp_path / "out" / kind).iterdir()} == {path.name for path in paths}
    assert {path.name for path in tmp_path.iterdir()} == {"result.h5", "out"}
    head, *_ = (tmp_path / "out/csv/samples.csv").read_text().splitlines()
    assert "'=1+1 []" in head.split(",")
    assert (tmp_path / "out/csv/events.csv").read_text().splitlines()[1] == "0.0,'@a,'=b,{}"


@pytest.mark.parametrize("name", ["../../x", "/etc/x", "..", ".", "", ".hidden", "a b"])
def test_stem_of_a_file_has_no_folder(name: str) -> None:
    stem = file_stem(name)
    assert Path(f"{stem}.csv").name == f"{stem}.csv" and not stem.startswith(".")


@pytest.mark.parametrize("text", ["=1", "+1", "-1", "@a", "\t=1", "\r=1"])
def test_no_cell_is_a_formula(text: str) -> None:
    assert spreadsheet_cell(text) == f"'{text}"
    assert spreadsheet_cell(f"a{text}") == f"a{text}" and spreadsheet_cell("") == ""


def _up(file: h5py.File) -> None:
    file.create_group("..").create_dataset("x", data=np.arange(3.0))


def _link(file: h5py.File) -> None:
    file["x"] = h5py.ExternalLink("/dev/zero", "/x")


def _external(file: h5py.File) -> None:
    file.create_dataset("x", (3,), "f8", external=[("/dev/zero", 0, 24)])


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", (3,))
    file.create_virtual_dataset("x", layout)


def _bomb(file: h5py.File) -> None:
    for k in range(3):
        file.create_dataset(f"x{k}", (ROOM // 16,), "f8", chunks=True, compression="gzip")


@pytest.mark.parametrize(
    ("make", "reason"),
    [(_up, "leads out"), (_link, "leads out"), (_external, "another file"), (_virtual, "another file"), (_bomb, "expands")],
)  # fmt: skip
def test_a_result_lies_in_its_file_and_does_not_expand(stored: Path, make: object, reason: str) -> None:
    with h5py.File(stored, "r+") as file:
        make(file)  # type: ignore[operator]
    with pytest.raises(ResultFileError, match=reason):
        read(stored)


# -- meshes ----------------------------------------------------------------------------------------------
COLLADA = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><library_geometries><geometry id="g">'
    '<mesh><source id="s"><float_array id="f" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>'
    '<accessor source="#f" count="3" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
    '<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v">'
    '<input semantic="POSITION" source="#s"/></vertices><triangles count="1">'
    '<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry></library_geometries>'
    '<library_nodes><node id="n0">{leaf}</node>{nodes}</library_nodes><library_visual_scenes><visual_scene id="w">'
    '<node id="r"><instance_node url="#n{last}"/></node></visual_scene></library_visual_scenes>'
    '<scene><instance_visual_scene url="#w"/></scene></COLLADA>'
)
DOUBLED = '<node id="n{}"><instance_node url="#n{}"/><instance_node url="#n{}"/></node>'


def _doubled(times: int, leaf: str = '<instance_geometry url="#g"/>') -> str:
    nodes = "".join(DOUBLED.format(k, k - 1, k - 1) for k in range(1, times + 1))
    return COLLADA.format(leaf=leaf, nodes=nodes, last=times)


@pytest.mark.skipif(not can_read_dae(), reason="needs pycollada")
def test_instances_of_collada_are_bounded() -> None:
    assert len(read_dae(_doubled(3).encode()).faces) == 8
    for leaf in ('<instance_geometry url="#g"/>', ""):
        with pytest.raises(MeshError, match=f"more than {MOST_NODES}"):
            read_dae(_doubled(40, leaf).encode())
    with pytest.raises(MeshError):
        read_dae(_doubled(0, '<instance_node url="#n0"/>').encode())


@pytest.mark.skipif(not can_read_dae(), reason="needs pycollada")
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1"])
def test_a_document_type_is_refused_in_every_encoding(encoding: str) -> None:
    head = f'<?xml version="1.0" encoding="{encoding}"?>'
    assert len(read_dae((head + _doubled(0)).encode(encoding)).faces) == 1
    with pytest.raises(MeshError, match="document type"):
        read_dae((head + '<!DOCTYPE a [<!ENTITY b "c">]>' + _doubled(0)).encode(encoding))
