"""``robodyn export SCENE --c DIR --target PROCESSOR``: objects for controllers, their sizes, what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.cli.commands import export
from robodyn_cli.kernels.compiler import OTHER_TARGETS
from robodyn_cli.kernels.elf import sections_of
from robodyn_cli.over.c99.objects import PROCESSORS

SCENE = Path(__file__).parents[2] / "configs" / "four_bar_deploy.yaml"
VERSION = tuple(int(x) for x in llvmlite.__version__.split(".")[:2])
ARM = 40  # of the machines that ELF numbers
LIBRARY = {"cos", "sin", "strcmp"}


def asked(folder: Path, *options: str) -> int:
    return run(["export", str(SCENE), "--c", str(folder), "--target", "cortex-m7", *options])


@pytest.mark.skipif(VERSION < OTHER_TARGETS, reason="llvmlite is too old for other processors")
def test_objects_for_cortex_m7(tmp_path: Path, capsys: Any) -> None:
    """The header's functions, in registers for floating point, with the sizes that LLVM reads."""
    folder = tmp_path / "c"
    assert asked(folder, "--json") == 0
    said = json.loads(capsys.readouterr().out)["objects"]
    assert [x["file"] for x in said] == [f"four_bar_deploy_cortex_m7{x}.o" for x in ("", "_single")]
    declared = set(
        re.findall(r"\b(four_bar_deploy_\w+)\(", (folder / "four_bar_deploy.h").read_text("utf-8"))
    )
    page = (folder / "README.md").read_text("utf-8")
    for one, suffix in zip(said, ("", "f")):
        code = (folder / one["file"]).read_bytes()
        assert code[:5] == b"\x7fELF\x01" and int.from_bytes(code[18:20], "little") == ARM
        sections = {x.name: x for x in sections_of(code)}
        read = {
            x.name().decode(): x.size() for x in llvm.ObjectFileRef.from_data(code).sections() if x.is_text()
        }
        assert one["text"] == sum(read.values()) > 1000 and one["data"] == one["bss"] == 0
        assert {name.removeprefix(".text.") for name in read} >= declared
        assert b"\x1c\x01" in sections[".ARM.attributes"].content  # Tag_ABI_VFP_args: registers of the unit
        others = {x for x in one["calls"] if not x.startswith("__aeabi_mem")}
        assert others == {x + suffix if x != "strcmp" else x for x in LIBRARY}
        assert f"`{one['file']}`" in page and re.search(rf"\| text \|.* {one['text']} ", page)
    assert said[1]["text"] < said[0]["text"]
    assert asked(folder) == 0
    assert f"double: text {said[0]['text']}, rodata" in capsys.readouterr().out


def test_what_is_refused(tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert tuple(PROCESSORS) == export.PROCESSORS
    assert run(["export", str(SCENE), "--c", str(tmp_path / "c"), "--target", "cortex-m8"]) == 2
    assert "'cortex-m8'; allowed: cortex-m7" in capsys.readouterr().err
    assert run(["export", str(SCENE), "--fmu", str(tmp_path / "x.fmu"), "--target", "cortex-m7"]) == 2
    assert "--target goes with --c" in capsys.readouterr().err
    monkeypatch.setattr(llvmlite, "__version__", "0.49.1")
    assert asked(tmp_path / "c") == 2
    assert "takes llvmlite 0.50 or newer; here it is 0.49.1" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
