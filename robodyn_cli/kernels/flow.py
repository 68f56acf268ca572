"""The text of a function under construction, and its control flow as ``with`` blocks.

    with f.when(condition):         with f.loop() as rounds:            with f.block() as search:
        ...                             ...                                 ...
    with f.otherwise():                 rounds.leave(condition)             search.leave(condition)
        ...                             rounds.again()                      ...

Labels and jumps stay in this package. What follows an unconditional ``leave``, ``again`` or ``ret`` in the same block
is never reached.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from robodyn_cli.kernels.values import Condition, Int, ref_of


class Flow:
    """Lines of a function, and what decides which of them run."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.slots: list[str] = []
        self.counter = 0
        self._closed = False  # the last line jumps: what comes next needs a label to be reached
        self._when = (
            -1,
            "",
            False,
        )  # of the last ``when``: lines at its end, its label, whether it jumps there

    # -- lines ----------------------------------------------------------------------------------------
    def fresh(self, prefix: str = "v") -> str:
        self.counter += 1
        return f"{prefix}{self.counter}"

    def raw(self, text: str) -> None:
        if self._closed:
            self.place(self.label("unreached"))
        self.lines.append("  " + text)

    def name(self, text: str) -> str:
        """Emit an instruction and return the register that holds its result."""
        ref = "%" + self.fresh()
        self.raw(f"{ref} = {text}")
        return ref

    @contextlib.contextmanager
    def entry(self) -> Iterator[None]:
        """Emit at the start of the function, for addresses that all of it uses."""
        before, closed = self.lines, self._closed
        self.lines, self._closed = self.slots, False
        try:
            yield
        finally:
            self.lines, self._closed = before, closed

    # -- labels and jumps, for this package only ------------------------------------------------------
    def label(self, hint: str) -> str:
        return self.fresh(hint + ".")

    def place(self, label: str) -> None:
        self.lines.append(f"{label}:")
        self._closed = False

    def jump(self, label: str) -> None:
        if not self._closed:
            self.raw(f"br label %{label}")
            self._closed = True

    def branch(self, condition: Condition, yes: str, no: str) -> None:
        self.raw(f"br i1 {condition.ref}, label %{yes}, label %{no}")
        self._closed = True

    def ret(self, value: Int | int | None = None) -> None:
        """Return from the function."""
        self.raw("ret void" if value is None else f"ret i64 {ref_of(value)}")
        self._closed = True

    # -- blocks ---------------------------------------------------------------------------------------
    @contextlib.contextmanager
    def when(self, condition: Condition) -> Iterator[None]:
        """Emit the body so that it runs only if the condition holds."""
        yes, after = self.label("then"), self.label("after")
        self.branch(condition, yes, after)
        self.place(yes)
        yield
        jumps = not self._closed
        self.jump(after)
        self.place(after)
        self._when = (len(self.lines), after, jumps)

    @contextlib.contextmanager
    def otherwise(self) -> Iterator[None]:
        """Emit the body so that it runs only if the condition of the ``when`` right above does not hold.

        Raises
        ------
        ValueError : there is code in between.
        """
        lines, no, jumps = self._when
        if lines != len(self.lines):
            raise ValueError("'otherwise' has to follow its 'when'")
        after = self.label("after")
        del self.lines[-1 - jumps :]
        self._closed = not jumps
        self.jump(after)
        self.place(no)
        yield
        self.jump(after)
        self.place(after)

    @contextlib.contextmanager
    def block(self) -> Iterator[Block]:
        """Emit a body that can be left early."""
        block = Block(self, self.label("left"))
        yield block
        self.jump(block.end)
        self.place(block.end)

    @contextlib.contextmanager
    def loop(self) -> Iterator[LoopBlock]:
        """Emit a body that runs again and again until it is left."""
        loop = LoopBlock(self, self.label("loop"), self.label("left"))
        self.jump(loop.head)
        self.place(loop.head)
        yield loop
        self.jump(loop.head)
        self.place(loop.end)


class Block:
    """A part of the code that can be left early."""

    def __init__(self, f: Flow, end: str) -> None:
        self.f = f
        self.end = end

    def leave(self, condition: Condition | None = None, *, unless: Condition | None = None) -> None:
        """Go on behind the block: always, if a condition holds, or unless one holds."""
        self._go(self.end, condition, unless)

    def _go(self, label: str, condition: Condition | None, unless: Condition | None) -> None:
        f = self.f
        onward = f.label("onward")
        if condition is not None:
            f.branch(condition, label, onward)
        elif unless is not None:
            f.branch(unless, onward, label)
        else:
            f.jump(label)
            return
        f.place(onward)


class LoopBlock(Block):
    """A body that is repeated until it is left."""

    def __init__(self, f: Flow, head: str, end: str) -> None:
        super().__init__(f, end)
        self.head = head

    def again(self, condition: Condition | None = None) -> None:
        """Start over with the body: always, or if a condition holds."""
        self._go(self.head, condition, None)
