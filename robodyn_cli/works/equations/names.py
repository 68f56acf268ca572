"""What numbers, coordinates and rates of a scene are called in its equations, in text, LaTeX and Python."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable
from typing import Any

from robodyn_cli.expr.fixed import Fixed, places
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import PARAMETER_GROUP, TORQUE, UNKNOWN_GROUP, Model
from robodyn_cli.record import record

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "zeta": "ζ", "eta": "η", "theta":
    "θ", "iota": "ι", "kappa": "κ", "lambda": "λ", "mu": "μ", "nu": "ν", "xi": "ξ", "pi": "π", "rho": "ρ",
    "sigma": "σ", "tau": "τ", "upsilon": "υ", "phi": "φ", "chi": "χ", "psi": "ψ", "omega": "ω", "Gamma": "Γ",
    "Delta": "Δ", "Theta": "Θ", "Lambda": "Λ", "Xi": "Ξ", "Pi": "Π", "Sigma": "Σ", "Phi": "Φ", "Psi": "Ψ",
    "Omega": "Ω",
}  # fmt: skip
SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
DOTS = ("", "\u0307", "\u0308")  # above the letter before
ACCENTS = ("", "dot", "ddot")
SHORT = re.compile(rf"({'|'.join(GREEK)}|[A-Za-z])_?(\d*)")
AXES = "xyz"
# letters of numbers by the last word of their key; those of other keys are the word itself
LETTERS = {
    "mass": "m", "stiffness": "k", "damping": "b", "length": "l", "rotor_inertia": "J", "gear_ratio": "n", "com": "c",
    "inertia": "I", "rest_length": "l0", "xyz": "", "at": "", "gravity": "g",
}  # fmt: skip
MOST_PLACES = 3  # that are listed of a computed number
# names that a module of equations has already
TAKEN = {
    "sp", "t", "q", "qd", "qdd", "v", "vd", "M", "C", "G", "F_passive", "F_friction", "F_external", "F_gear", "F_stops",
    "tau", "eta", "Psi", "gamma", "eta_t", "qdot", "where", "values", "lam", "residual",
}  # fmt: skip
TABLE = re.compile(r"table\d+")  # what functions by tables are called there


@record
class Symbol:
    """A name in the equations.

    key : in Python, unique. place : its key in the scene. value : None where it is no number of the scene. meaning :
    in words. is_number : whether it is constant along a motion.
    """

    key: str
    text: str
    latex: str
    meaning: str = ""
    place: str = ""
    value: float | None = None
    unit: str = ""
    is_number: bool = False


def text_name(name: str, order: int = 0) -> str:
    """Return a name of the scene in text, its rate of an order: θ₁ of theta1; slide' of slide."""
    match = SHORT.fullmatch(name)
    if match is None:
        return name + "'" * order
    letter, digits = match.groups()
    return GREEK.get(letter, letter) + DOTS[order] + digits.translate(SUBSCRIPTS)


def latex_name(name: str, order: int = 0) -> str:
    r"""Return a name of the scene in LaTeX: \theta_{1} of theta1; \dot{q}_{\mathrm{slide}} as the rate of slide."""
    match = SHORT.fullmatch(name)
    letter, digits = match.groups() if match else ("q", "")
    base = f"\\{letter}" if letter in GREEK else letter
    base = f"\\{ACCENTS[order]}{{{base}}}" if order else base
    if match is None:
        return f"{base}_{{{_upright(name)}}}" if order else _upright(name)
    return f"{base}_{{{digits}}}" if digits else base


def _upright(text: str) -> str:
    return rf"\mathrm{{{latex_text(text)}}}"


def latex_text(text: str) -> str:
    """Return a text that LaTeX takes as it is, letters that it may lack as a question mark."""
    special = {"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "−": "-"}
    plain = []
    for letter in text:
        if letter in special:
            plain.append(special[letter])
        elif letter in "{}$&#_%":
            plain.append(f"\\{letter}")
        else:
            plain.append(letter if " " <= letter <= "~" else "?")
    return "".join(plain)


def _subscripted(letter: str, below: str, axes: str = "") -> tuple[str, str]:
    """Return a letter with axes and a name of the scene below it, in text and LaTeX."""
    if SHORT.fullmatch(letter):
        head, _, own = latex_name(letter).partition("_")
    else:
        head, own = _upright(letter), ""
    inside = [x for x in (own.strip("{}"), axes, _inside(below) if below else "") if x]
    text = f"{text_name(letter)}{axes}" + (f"_{text_name(below)}" if below else "")
    return text, f"{head}_{{{','.join(inside)}}}" if inside else head


def _inside(below: str) -> str:
    return latex_name(below) if SHORT.fullmatch(below) else _upright(below)


class SymbolNames:
    """The symbols of one model.

    Parameters
    ----------
    gravity : its components; the only one that is not zero is called g, and counts upwards.
    unit_of : unit of the key of a number in the scene. as_numbers : whether numbers stand for themselves.
    """

    def __init__(
        self, model: Model, gravity: Any, unit_of: Callable[[str], str], as_numbers: bool = False
    ) -> None:
        self.model, self.unit_of, self.as_numbers = model, unit_of, as_numbers
        along = [k for k, x in enumerate(gravity) if x]
        self.down = f"gravity.{along[0]}" if len(along) == 1 and gravity[along[0]] < 0.0 else ""
        self._by_key: dict[str, Symbol] = {}
        self._known: dict[Any, Symbol] = {}
        self._shown: set[str] = set()
        self._computed = 0
        self.orders = {"q": 0, "v": 1, "a": 2}

    # -- nodes of the graph ------------------------------------------------------------------------
    def parts(self, x: Any) -> tuple[str, tuple[Any, ...], Any]:
        """Return the operation, arguments and value of a node of the graph or of a number of the scene."""
        if isinstance(x, Expr):
            return self.parts(x.value) if x.op == "const" else (x.op, x.args, x.value)
        if isinstance(x, Fixed) and not self.as_numbers:
            return (x.op, (), x) if x.op in ("literal", "entry") else (x.op, x.args, None)
        return "number", (), float(x)

    def symbol(self, text: str, group: str, position: int) -> Symbol:
        """Return the symbol of an input of the equations."""
        key = (group, position, text if group == UNKNOWN_GROUP else "")
        if key not in self._known:
            self._known[key] = self._input(text, group, position)
        return self._known[key]

    def _input(self, text: str, group: str, position: int) -> Symbol:
        if group in ("v", "a"):
            return self.rate(position, self.orders[group])
        if group == "q":
            own = self.model.q_names[position]
            return self._new(own, *self._coordinate(own, 0), unit=self.model.q_units[position])
        if group == "t":
            return self._new("t", "t", "t", meaning="time", unit="s", reserved=False)
        if group == UNKNOWN_GROUP:
            datum, _, owner = text.partition(" of ")
            letter, axes, below, _ = letter_of(f"robot.links.{owner or datum}.{datum}")
            key = f"{letter}{axes}_{below}"
            return self._new(
                key, *_subscripted(letter, below, axes), meaning=f"{text}, not given", is_number=True
            )
        below, _, last = text.rpartition(".")
        meaning = _switch(below, last) if group == PARAMETER_GROUP else text
        if below == "payloads":
            last, below = "carried", last
        return self._new(f"{last}_{below}", *_subscripted(last, below), meaning=meaning)

    def rate(self, position: int, order: int) -> Symbol:
        """Return the rate of a velocity coordinate, or its rate in turn: order 1 and 2."""
        own, unit = self.model.v_names[position], self.model.v_units[position]
        key = ("v", position, order)
        if key not in self._known:
            quasi = own not in self.model.q_names
            shown = self._coordinate(own, order - 1 if quasi else order)
            suffix = "d" * (order - 1 if quasi else order)
            unit = f"{unit}/s" if order == 1 else f"{unit}/s^2"
            self._known[key] = self._new(f"{own}{'_' if suffix else ''}{suffix}", *shown, unit=unit)
        return self._known[key]

    def torque(self, position: int) -> Symbol:
        """Return the torque of an actuator, which nothing in the scene gives."""
        own, unit = self.model.v_names[position], TORQUE[self.model.v_units[position]]
        kind = "torque" if unit == "N m" else "force"
        return self._once(("tau", position), f"tau_{own}", lambda: self._of_coordinate("tau", own),
                          f"{kind} of an actuator, in {unit}")  # fmt: skip

    def multiplier(self, row: int, name: str) -> Symbol:
        """Return the multiplier of a row of the constraints."""
        key = f"lambda{row + 1}"
        shown = text_name(key), latex_name(key)
        return self._once(("lambda", row), key, lambda: shown, f"multiplier of {name}")

    def _once(self, key: Any, name: str, shown: Callable[[], tuple[str, str]], meaning: str) -> Symbol:
        if key not in self._known:
            self._known[key] = self._new(name, *shown(), meaning=meaning)
        return self._known[key]

    @staticmethod
    def _of_coordinate(letter: str, own: str) -> tuple[str, str]:
        """Return a letter with a coordinate below it."""
        joint, _, axes = own.rpartition(".")
        return _subscripted(letter, joint or own, axes if joint else "")

    @property
    def motion(self) -> list[Symbol]:
        """Coordinates and their rates, in their order."""
        model = self.model
        return [
            *(self.symbol(own, "q", k) for k, own in enumerate(model.q_names)),
            *(self.rate(k, 1) for k in range(model.nv)),
        ]

    @staticmethod
    def _coordinate(own: str, order: int) -> tuple[str, str]:
        """Return a coordinate, or its rate, in text and LaTeX; one of several of a joint has this below it."""
        joint, _, letter = own.rpartition(".")
        if not joint:
            return text_name(own, order), latex_name(own, order)
        match = SHORT.fullmatch(letter)
        base, axes = match.groups() if match else (letter[0], letter[1:])
        text, latex = _subscripted(base, joint, axes)
        plain, accented = latex_name(base), latex_name(base, order)
        return text.replace(text_name(base), text_name(base, order), 1), accented + latex.removeprefix(plain)

    # -- numbers of the scene -----------------------------------------------------------------------
    def number(self, x: Fixed) -> Symbol:
        """Return the symbol of a number of the scene."""
        key = x.args[0] if x.op == "literal" else (id(x.args[0]), x.args[1])
        if key not in self._known:
            self._known[key] = self._literal(x) if x.op == "literal" else self._entry(x)
        return self._known[key]

    def _literal(self, x: Fixed) -> Symbol:
        place, value = x.args[0], float(x)
        unit = self.unit_of(place)
        if place == self.down:
            return self._new("g", "g", "g", meaning="against gravity", place=place, value=-value, unit=unit,
                             is_number=True)  # fmt: skip
        letter, axes, below, longer = letter_of(place)
        if identifier(f"{letter}{axes}_{below}") in self._by_key:
            below = longer
        key = f"{letter}{axes}_{below}" if below else letter + axes
        return self._new(key, *_subscripted(letter, below, axes), place=place, value=value, unit=unit,
                         is_number=True)  # fmt: skip

    def _entry(self, x: Fixed) -> Symbol:
        """Return the symbol of a number that a function computes from others, such as a base parameter."""
        self._computed += 1
        of = places([x])
        meaning = (
            f"computed from {', '.join(of) if len(of) <= MOST_PLACES else f'{len(of)} numbers of the scene'}"
        )
        shown = _subscripted("p", str(self._computed))
        return self._new(f"p_{self._computed}", *shown, meaning=meaning, value=float(x), is_number=True)

    def temporary(self, count: int) -> Symbol:
        return self._new(f"w{count}", f"w{count}", f"w_{{{count}}}")

    def _new(self, key: str, text: str, latex: str, reserved: bool = True, **rest: Any) -> Symbol:
        """Return a new symbol; one that would be taken for another gets an underscore, in LaTeX a prime."""
        key = identifier(key)
        while (
            key in self._by_key
            or keyword.iskeyword(key)
            or (reserved and (key in TAKEN or TABLE.fullmatch(key)))
        ):
            key += "_"
        while text in self._shown:
            text, latex = f"{text}_", f"{latex}'"
        self._shown.add(text)
        symbol = self._by_key[key] = Symbol(key, text, latex, **rest)
        return symbol


def _switch(owner: str, field: str) -> str:
    """Return what a parameter that events change means."""
    if owner == "payloads":
        return f"1 while payload {field} is carried, else 0"
    meanings = {
        "direction": f"sense in which {owner} slides, 1 or -1; 0 while it is held",
        "hold": f"1 while {owner} is held, else 0",
    }
    return meanings.get(field, f"{field} of {owner}, set by events")


def letter_of(place: str) -> tuple[str, str, str, str]:
    """Return the letter of a number, its axes, what stands below it, and a longer form of that, from its key."""
    words = place.split(".")
    letter, axes, middle = words[-1], "", words[1:-1]
    longer = "_".join(middle) or words[0]
    if letter.isdigit() and len(words) > 1:
        letter, axes, middle = words[-2], AXES[int(letter)] if int(letter) < 3 else letter, words[1:-2]
    elif len(words) > 2 and words[-2] == "inertia":
        letter, axes, middle = "inertia", letter, words[1:-2]
    if words[0] in ("robot", "catalogue") and len(middle) > 1:
        middle = middle[1:]
    letter = LETTERS.get(letter, letter)
    if not letter:  # a coordinate of a place
        letter, axes = axes, ""
    return letter, axes, middle[0] if middle else "", longer


def identifier(text: str) -> str:
    """Return a name in Python, of plain letters."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return name if name[:1].isalpha() or name[:1] == "_" else f"_{name}"
