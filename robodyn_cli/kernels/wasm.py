"""LLVM IR as one WebAssembly module that a browser loads, without a linker.

LLVM's object file for wasm32 is a valid module as it stands: memory, stack pointer and function table are imported,
its constants begin at address 0, and calls and addresses hold their final values, since all texts are one module before
it is made. What it lacks are the exports; its custom sections are for linkers alone.

Binary format: WebAssembly core specification, section 5; the section ``linking`` of object files: tool conventions,
"WebAssembly Object File Linking".
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robodyn_cli.kernels.compiler import Target, compile_object
from robodyn_cli.record import record

WASM = Target(
    "wasm32-unknown-unknown", "generic", "+simd128,+bulk-memory,+nontrapping-fptoint,+sign-ext", lanes=2, fused=False
)  # fmt: skip
HEADER = 8  # bytes: magic number and version
CUSTOM, IMPORT, EXPORT, CODE, DATA = 0, 2, 7, 10, 11
COUNT = 12  # of data segments: its section comes before the code
SYMBOLS = 8  # subsection of ``linking``
UNDEFINED, NAMED = 0x10, 0x40  # flags of symbols
FUNCTION, TABLE, MEMORY, GLOBAL = range(4)  # kinds of imports; 0 is a function among symbols, too
DATA_SYMBOL, SECTION_SYMBOL = 1, 3


@record
class WasmModule:
    """A module. imports : functions of the C library that it needs. constants : bytes of memory, from 0 on, that are
    its own."""

    code: bytes
    imports: tuple[str, ...]
    constants: int


def write_wasm(texts: Sequence[str], exports: Sequence[str]) -> WasmModule:
    """Return the module of IR texts that call each other, written for the target ``WASM``; exports : its functions.

    Raises
    ------
    CapabilityError : llvmlite is too old.
    """
    code = compile_object(texts, WASM)
    sections = {kind: body for kind, body in _sections(code) if kind != CUSTOM}
    functions = _functions(code)
    rows = [_text(name) + bytes([FUNCTION]) + _number(functions[name]) for name in exports]
    sections[EXPORT] = _number(len(rows)) + b"".join(rows)
    order = sorted(sections, key=lambda kind: CODE - 0.5 if kind == COUNT else kind)
    whole = b"".join(bytes([kind]) + _number(len(sections[kind])) + sections[kind] for kind in order)
    return WasmModule(
        code[:HEADER] + whole, _imports(sections[IMPORT]), _constants(sections.get(DATA, b"\0"))
    )


class _ByteReader:
    """Bytes of a module, read one after another."""

    def __init__(self, data: bytes, at: int = 0) -> None:
        self.data, self.at = data, at

    def __bool__(self) -> bool:
        return self.at < len(self.data)

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def number(self) -> int:
        """Return an unsigned number, seven bits a byte (LEB128)."""
        value = shift = 0
        while True:
            byte = self.byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    def part(self) -> bytes:
        """Return bytes behind their number."""
        size = self.number()
        self.at += size
        return self.data[self.at - size : self.at]


def _sections(code: bytes) -> Iterator[tuple[int, bytes]]:
    reader = _ByteReader(code, HEADER)
    while reader:
        yield reader.byte(), reader.part()


def _functions(code: bytes) -> dict[str, int]:
    """Return the numbers of the functions that an object file defines, by name."""
    functions: dict[str, int] = {}
    for kind, body in _sections(code):
        section = _ByteReader(body)
        if kind != CUSTOM or section.part() != b"linking":
            continue
        section.number()  # version
        while section:
            sort, own = section.byte(), _ByteReader(section.part())
            for _ in range(own.number() if sort == SYMBOLS else 0):
                _read_symbol(own, functions)
    return functions


def _read_symbol(table: _ByteReader, functions: dict[str, int]) -> None:
    kind, flags = table.byte(), table.number()
    defined = not flags & UNDEFINED
    if kind == DATA_SYMBOL:
        table.part()
        for _ in range(3 if defined else 0):  # segment, place and size
            table.number()
        return
    place = table.number()
    if kind != SECTION_SYMBOL and (defined or flags & NAMED):
        name = table.part().decode()
        if kind == FUNCTION and defined:
            functions[name] = place


def _imports(body: bytes) -> tuple[str, ...]:
    """Return the names of the functions that are imported."""
    reader, names = _ByteReader(body), []
    for _ in range(reader.number()):
        reader.part()
        name, kind = reader.part().decode(), reader.byte()
        if kind == FUNCTION:
            names.append(name)
        if kind in (TABLE, GLOBAL):
            reader.byte()
        if kind in (TABLE, MEMORY):  # least, and most where the flag says so
            for _ in range(1 + (reader.byte() & 1)):
                reader.number()
        else:
            reader.number()
    return tuple(names)


def _constants(body: bytes) -> int:
    """Return the end of the last data segment; each lies at a constant address."""
    reader, end = _ByteReader(body), 0
    for _ in range(reader.number()):
        reader.number()  # flags: active
        reader.byte()  # i32.const
        first = reader.number()  # positive, so that the sign does not matter but for its bit
        reader.byte()  # end
        end = max(end, first + len(reader.part()))
    return end


def _number(n: int) -> bytes:
    """Return an unsigned number as LEB128."""
    out = bytearray()
    while n > 127:
        out.append(n & 127 | 128)
        n >>= 7
    return bytes([*out, n])


def _text(name: str) -> bytes:
    return _number(len(name.encode())) + name.encode()
