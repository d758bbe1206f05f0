"""Formulas: torques c₁ f₁(signals; s) + c₂ f₂(signals; s) + … of terms that a grammar builds.

A formula is written in Python over the signals q, v, a, load, t and temperature of its joint and
q_<other>, v_<other> of another one. The same text is evaluated with NumPy in a search, and is the
content of an effect file, which CasADi evaluates.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import product
from types import CodeType
from typing import Any, ClassVar

import numpy as np

from ident.effects.curve import OfSignals
from ident.effects.effect import (
    UNITS,
    Bounds,
    Estimates,
    Powers,
    Shape,
    Signals,
    Unknown,
    dimension,
    scaled,
    unit_of,
)
from ident.effects.joint import direction_in
from ident.text import rounded

FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "sign", "tanh")
OTHER = re.compile(r"\b([qv])_o\b")  # a signal of the second joint, before its name is known
WAVES = 1.25  # work: [1/travel] between the wave numbers at which a search begins
SMOOTH = 1e-3  # range: [rad/s | N m | 1] within which the sign of no joint's speed is smooth
SMOOTH_SIGN = f'''

def sign(x):
    """Return a sign that is smooth around zero."""
    return ca.tanh(x / {SMOOTH:g})'''
SIGN = re.compile(r"sign\((v|v_o)\)")  # of a joint's own speed
SIGNALS = frozenset({*UNITS, "q_o", "v_o"})
DESCRIPTION = "a description, not yet a cause"
WIDEST = 40  # numerics: exponents beyond which exp is not evaluated
FUNCTION_OF = {
    **{name: getattr(np, name) for name in FUNCTIONS},
    "abs": np.abs,
    "exp": lambda x: np.exp(np.minimum(x, WIDEST)),
}

Between = Callable[[float, float, float], tuple[float, float]]
SEARCHED: Mapping[str, tuple[Between, Callable[[float, float], Iterable[float]]]] = {
    # bounds, of a signal between two values and its span; and where a search between them begins
    "width": (lambda low, high, span: (0.02 * span, 3.0 * span),
              lambda low, high: np.geomspace(2.5 * low, high / 3, 5)),
    "place": (lambda low, high, span: (low - 0.5 * span, high + 0.5 * span),
              lambda low, high: np.linspace(0.7 * low + 0.3 * high, 0.3 * low + 0.7 * high, 6)),
    "beyond": (lambda low, high, span: (low - 3.0 * span, high + 3.0 * span),
               # 0.2 and 1 times the signal's range from its ends
               lambda low, high: low + (high - low) / 7 * np.array([2.0, 2.8, 4.2, 5.0])),
    "wave": (lambda low, high, span: (1.0 / span, 60.0 / span),
             lambda low, high: np.arange(1.5 * low, high, WAVES * low)),
    # a whole turn on either side of where a search begins, within π: a sign is the coefficient's
    "angle": (lambda *_: (-2 * np.pi, 2 * np.pi), lambda *_: np.arange(8) * np.pi / 8),
    "share": (lambda *_: (-0.98, 0.98), lambda *_: (-0.9, -0.5, 0.5, 0.9)),
    "exponent": (lambda *_: (-6.0, 6.0), lambda *_: (-2.0, -0.7, 0.7, 2.0)),
    "power": (lambda *_: (0.2, 4.0), lambda *_: (0.5, 1.5, 2.5)),
}  # fmt: skip


@dataclass(frozen=True)
class Scale:
    """A constant within a term, and where it is searched."""

    name: str  # in the term's text
    # what it is of its signal, a key of SEARCHED: the `width` of its range, a `place` in it or
    # `beyond` it, a `wave` over it; or an angle, a share, an exponent, a power
    of: str
    signal: str = ""  # whose range, a signal or a sum of two; empty where that does not matter

    @property
    def powers(self) -> Powers:
        """Powers of signals in its unit."""
        power = {"width": 1, "place": 1, "beyond": 1, "wave": -1}.get(self.of, 0)
        return scaled(dimension(self.signal), power) if power else {}

    def unit(self, rotational: bool, second: bool) -> str:
        """Return its unit, of joints that turn or not."""
        if self.of == "angle":
            return "rad"
        unit = unit_of(self.powers, rotational, second)
        return "1" if unit == "1/rad" else unit

    def bounds(self, x: np.ndarray) -> tuple[float, float]:
        """Return the lowest and highest value, given the signal x (n,)."""
        low, high = (float(x.min()), float(x.max())) if len(x) else (0.0, 0.0)
        return SEARCHED[self.of][0](low, high, max(high - low, 1e-9))

    def starts(self, x: np.ndarray) -> list[float]:
        """Return where a search begins."""
        return [float(start) for start in SEARCHED[self.of][1](*self.bounds(x))]


@dataclass(frozen=True)
class Term:
    """A part of a formula: columns f_i with a coefficient each, and constants within them."""

    columns: tuple[str, ...]  # Python texts
    scales: tuple[Scale, ...] = ()  # the constants
    known_as: str = ""  # name of the law in the literature; empty where it has none

    @cached_property
    def powers(self) -> tuple[Powers, ...]:
        """Powers of signals in the unit of each column."""
        of = {scale.name: scale.powers for scale in self.scales}
        return tuple(dimension(text, of) for text in self.columns)

    @cached_property
    def cost(self) -> int:
        """Complexity: constants, and operators and functions of its text."""
        text = " + ".join(self.columns)
        symbols = len(re.findall(r"\*\*|[-+*/]|[a-z]+\(", text))
        return len(self.columns) + len(self.scales) + symbols

    @cached_property
    def signals(self) -> frozenset[str]:
        """Signals in its text."""
        words = set(re.findall(r"\b[a-z]+(?:_o)?\b", " ".join(self.columns)))
        return frozenset(words & SIGNALS)

    def renamed(self, suffix: str) -> Term:
        """Return the term with a suffix on its constants, so that a sum has each name once."""
        new = {scale.name: f"{scale.name}{suffix}" for scale in self.scales}
        word, new_name = re.compile(r"\b[A-Za-z_]\w*\b"), lambda m: new.get(m.group(), m.group())
        columns = tuple(word.sub(new_name, text) for text in self.columns)
        scales = tuple(Scale(new[s.name], s.of, s.signal) for s in self.scales)
        return Term(columns, scales, self.known_as)


@cache
def _code(text: str) -> CodeType:
    return compile(text, "formula", "eval")


def _value(text: str, names: Mapping[str, Any]) -> np.ndarray:
    return np.asarray(eval(_code(text), {"__builtins__": {}}, names))


@dataclass(frozen=True)
class Formula(OfSignals):
    """A sum of terms of one joint's signals, and of another joint's."""

    signature: ClassVar[str] = "the residual against the signals is this formula"
    source: ClassVar[str] = "found in the data"
    terms: tuple[Term, ...] = field(default=(), kw_only=True)
    name: str = field(default="law", kw_only=True)  # of the function in its file, and of the kind
    # of each constant within the terms, where a search begins, and its bounds
    found: Mapping[str, tuple[float, float, float]] = field(default_factory=dict, kw_only=True)

    @property
    def kind(self) -> str:  # type: ignore[override]
        return self.name

    @property
    def equation(self) -> str:  # type: ignore[override]
        return self.text

    @property
    def arity(self) -> int:  # type: ignore[override]
        return len(self.joints)

    @property
    def label(self) -> str:
        """Its text, with its joint."""
        return f"{self.text}:{','.join(self.joints)}"

    @property
    def names(self) -> tuple[str, ...]:
        stem = f"{self.name}.{','.join(self.joints)}"
        return tuple(f"{stem}.{p.name}" for p in self.parameters)

    @cached_property
    def renamed(self) -> tuple[Term, ...]:
        """The terms, with every constant's name once."""
        if len(self.terms) == 1:
            return self.terms
        return tuple(term.renamed(str(i + 1)) for i, term in enumerate(self.terms))

    @cached_property
    def columns_text(self) -> tuple[str, ...]:
        """Texts of all columns; signals of the other joint end in `_o`."""
        return tuple(text for term in self.renamed for text in term.columns)

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        unknowns, second = [], self.second_rotational
        every = [scaled(powers, -1) for term in self.renamed for powers in term.powers]
        for i, inverse in enumerate(every, 1):
            units = tuple(unit_of(inverse, rotational, second, 1.0) for rotational in (True, False))
            unknowns.append(Unknown(f"k{i}" if len(every) > 1 else "k", units, "coefficient"))
        return tuple(unknowns)

    @cached_property
    def shapes(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        units = [
            [x.unit(rotational, self.second_rotational) for rotational in (True, False)]
            for x in self.scales
        ]
        both = zip(self.scales, units, strict=True)
        return tuple(
            Unknown(scale.name, tuple(rotational), "constant") for scale, rotational in both
        )

    @property
    def scales(self) -> tuple[Scale, ...]:
        """All constants."""
        return tuple(scale for term in self.renamed for scale in term.scales)

    @property
    def depends_on(self) -> frozenset[str]:
        """Signals in its text; those of the other joint end in `_o`."""
        return frozenset().union(*(term.signals for term in self.terms))

    @property
    def logged(self) -> tuple[str, ...]:
        """Signals in its text, as columns of a log: `q.elbow`."""
        return tuple(
            f"{name.removesuffix('_o')}.{self.joints[name.endswith('_o')]}" if name != "t" else name
            for name in sorted(self.depends_on)
        )

    @property
    def dry(self) -> bool:
        return any(SIGN.search(text) for text in self.columns_text)

    @property
    def cost(self) -> int:
        """Complexity of all terms, with the sums between them."""
        return sum(term.cost for term in self.terms) + len(self.terms) - 1

    def written(self, text: str) -> str:
        """Return a text with the other joint's name."""
        other = (
            file_name_of(self.joints[1]).replace("-", "_").replace(".", "_")
            if self.arity > 1
            else "o"
        )
        return OTHER.sub(rf"\1_{other}", text)

    @property
    def text(self) -> str:
        """The formula in Python, with its constants' names: `k*sin(q + b)`."""
        products = [
            # k for a text of 1, k/x for one of 1/x
            f"{k.name}{text[1:]}" if re.match(r"1(/|$)", text) else f"{k.name}*{factor(text)}"
            for k, text in zip(self.unknowns, self.columns_text, strict=True)
        ]
        return self.written(" + ".join(products))

    # --- evaluation -----------------------------------------------------------------------------

    def torque(self, s: Signals) -> np.ndarray:
        names = {**self._namespace(s), **s.shape}
        with np.errstate(all="ignore"):
            E = [np.broadcast_to(_value(text, names), s.t.shape) for text in self.columns_text]
        return np.where(np.isfinite(E), E, 0.0).T

    def of_signal(self, name: str, x: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """Return the torque (n,) at values (n,) of its only signal, and values of its constants."""
        return _value(self.text, {**FUNCTION_OF, name: x, **values}) * np.ones_like(x)

    def bounds(self, s: Signals) -> Bounds:
        if self.found:
            return {name: (low, high) for name, (_, low, high) in self.found.items()}
        names = self._namespace(s)
        return {x.name: x.bounds(_value(x.signal or "t", names)) for x in self.scales}

    def starts(self, s: Signals) -> list[Shape]:
        if self.found:
            return [{name: start for name, (start, _, _) in self.found.items()}]
        names = self._namespace(s)
        every = [scale.starts(_value(scale.signal or "t", names)) for scale in self.scales]
        labels = [scale.name for scale in self.scales]
        return [dict(zip(labels, values, strict=True)) for values in product(*every)]

    def _namespace(self, s: Signals) -> dict[str, Any]:
        namespace: dict[str, Any] = {
            **FUNCTION_OF, "q": s.q[:, 0], "v": s.v[:, 0], "a": s.a[:, 0], "t": s.t - s.t[0],
        }  # fmt: skip
        if self.implicit:  # the model predicts it, which takes time
            namespace["load"] = s.load[:, 0]
        if s.q.shape[1] > 1:
            namespace |= {"q_o": s.q[:, 1], "v_o": s.v[:, 1]}
        for name in self.reads():
            namespace["temperature"] = s.extra[name]
        turns = {id(namespace[name]): i for i, name in enumerate(("v", "v_o")) if name in namespace}

        turning = direction_in(s, self.joints)

        def sign(x: np.ndarray) -> np.ndarray:
            i = turns.get(id(x))
            return np.tanh(x / SMOOTH) if i is None else turning[:, i]

        return {**namespace, "sign": sign}

    # --- effect file ----------------------------------------------------------------------------

    @property
    def file_name(self) -> str:
        """Name of its effect file."""
        return f"{self.name}_{file_name_of(self.joints[0])}.py"

    def source_file(self, estimates: Estimates) -> tuple[str, bytes] | None:
        """Return name and content of its effect file; None if its constants were not found yet."""
        if len(self.found) < len(self.shapes):
            return None
        at = ("[0]", "[1]") if len(self.joints) > 1 else ("", "")
        texts = [SIGN.sub(r"sign_\1", text) for text in self.columns_text]
        words = {*re.findall(r"\w+", " ".join(texts))}
        signals = {f"{x}{o}": f"s.{x}{at[bool(o)]}" for x in UNITS for o in ("", "_o")}
        signals |= {"t": "s.t", "load": f"s.lam{at[0]}"}
        signals |= {f"sign_v{o}": f"s.direction{at[bool(o)]}" for o in ("", "_o")}
        units = dict(zip((u.name for u in self.parameters), self.units, strict=True))
        given = ""
        for name, (start, low, high) in self.found.items():
            start = estimates.get(name, (start, None))[0]
            low, high = min(low, start), max(high, start)
            given += f', {name}: "{units[name]}" = ({start:.6g}, {low:.6g}, {high:.6g})'
        functions = [word for word in FUNCTIONS if word in words and word != "sign"]
        values = [f"    {n} = {rounded(*estimates[n])} {units[n]}" for n in units if n in estimates]
        parts = [
            f'"""A law found in the data of {file_name_of(self.joints[0])}: {DESCRIPTION}."""\n',
            "import casadi as ca",
            *([f"from casadi import {', '.join(functions)}"] if functions else []),
            *([SMOOTH_SIGN] if "sign" in words else []),
            f"\n\ndef {self.name}(s{given}):",
            "\n".join([f'    """{self.text}', *(["", *values, "    "] if values else [])]) + '"""',
            *(
                f"    {self.written(name)} = {signals[name]}"
                for name in (*sorted(self.depends_on), "sign_v", "sign_v_o")
                if name in words
            ),
            "    return {",
            *(
                f'        "{u.name} [{units[u.name]}]": {self.written(text)},'
                for u, text in zip(self.unknowns, texts, strict=True)
            ),
            "    }\n",
        ]
        return self.file_name, "\n".join(parts).encode()


def file_name_of(text: str) -> str:
    """Return a name that is safe as a file's name and within a text of Python."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", text).replace("..", "_")


def factor(text: str) -> str:
    """Return a text as a factor: in brackets where a sum is outside all of its own."""
    node = ast.parse(text, mode="eval").body
    is_sum = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)
    return f"({text})" if is_sum else text
