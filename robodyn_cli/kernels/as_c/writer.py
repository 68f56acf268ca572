"""The IR that kernels write as C99, statement for statement: no allocation, no globals, ``libm`` alone.

The IR has no phi instructions (what a loop keeps lies in slots), so a function becomes declarations, statements, labels
and ``goto``. Memory is read and written through ``memcpy``, which compilers turn into loads and stores.

Vectors are arrays that statements go through lane by lane, or those of GCC and Clang where ``VECTORS`` is defined: each
statement has both forms. A number in all lanes stays a number.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from robodyn_cli.kernels.as_c.ir_text import IrFunction, functions_of
from robodyn_cli.kernels.as_c.operations import FunctionText
from robodyn_cli.kernels.as_c.words import CFile, head, table, text_beside, used_functions

HEAD = """
#ifdef VECTORS
#define VECTOR(type, name, n) typedef type name __attribute__((vector_size(8 * n)))
#define EACH(n, whole, lane) whole
#else
#define VECTOR(type, name, n) typedef type name[n]
#define EACH(n, whole, lane) for (k = 0; k < n; ++k) lane
#endif
#define LANES(n, lane) for (k = 0; k < n; ++k) lane
"""


def write_c99(texts: Sequence[str], exports: Collection[str], calls: Mapping[str, str]) -> str:
    """Return the C of modules of IR that call each other.

    Parameters
    ----------
    exports : functions that are called from elsewhere in the file; of others what these reach is written.
    calls : what is called by an address of this name; an empty name: there is no such function.
    """
    functions, constants = functions_of(texts)
    reached = _reached(functions, exports, calls)
    file = CFile(calls, constants, frozenset(functions))
    bodies = [FunctionText(file, functions[name]).text for name in functions if name in reached]
    heads = [head(functions[name]) + ";" for name in functions if name in reached]
    kinds = [f"VECTOR({'double' if x == 'd' else 'int64_t'}, {x}{n}, {n});" for x, n in sorted(file.vectors)]
    tables = [table(name, constants[name]) for name in constants if name in file.tables]
    calls_of_helpers = " ".join(f"{name}(" for name in file.helpers)
    helpers = used_functions(text_beside(__file__, "helpers.c"), [calls_of_helpers])
    return "\n".join([HEAD, *kinds, "", helpers, *tables, "", *heads, "", *bodies])


def _reached(
    functions: Mapping[str, IrFunction], exports: Collection[str], calls: Mapping[str, str]
) -> set[str]:
    found: set[str] = set()
    pending = list(exports)
    while pending:
        name = pending.pop()
        if name in functions and name not in found:
            found.add(name)
            called = [i.callee for i in functions[name].code if i.op == "call"]
            pending += [x[1:] if x[0] == "@" else calls.get(x[1:], "") for x in called]
    return found
