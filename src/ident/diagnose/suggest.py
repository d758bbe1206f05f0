"""For what no effect of the library explains: a sparse expression of the signals, if one does.

    residual of joint j ≈ Σ c_i f_i(q, v, a, t)      f_i: products of powers, sines and signs

Terms are added one by one, everything else refitted, as long as the held-out error falls; what
explains two thirds of the gap is proposed as an effect of one's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.diagnose.evidence import BEYOND, CLOSES, SURE, Evidence, evidence, zscore
from ident.diagnose.null import Null
from ident.diagnose.screen import Screen
from ident.diagnose.search import Candidate
from ident.effects import Signals, create
from ident.effects.friction import direction
from ident.fit.table import Table

MOST = 3  # terms
Column = Callable[[Signals], np.ndarray]


@dataclass(frozen=True)
class Term:
    """f(signals): its CasADi text, and its value (n,) of the signals of one or two joints."""

    text: str
    joints: tuple[str, ...]
    value: Column


@dataclass(frozen=True, eq=False)
class Suggestion:
    """An expression that explains what is left of a joint's torque.

    Attributes:
        joint: whose torque; joints: whose signals, that joint first.
        terms: CasADi texts; values: their coefficients.
        closure: share of the gap that it closes.
    """

    joint: str
    joints: tuple[str, ...]
    terms: tuple[str, ...]
    values: tuple[float, ...]
    closure: float

    @property
    def code(self) -> str:
        """A file for `--with FILE:suggested:…`."""
        lines = [f'        "c{i + 1}": {text},' for i, text in enumerate(self.terms)]
        return "\n".join(
            [
                f'"""Suggested by a diagnosis for {self.joint}: a description, not yet a cause."""',
                "",
                "import casadi as ca",
                "",
                "",
                "def suggested(s):",
                f'    """Signals of {", ".join(self.joints)}; the torque acts on the first."""',
                "    return {",
                *lines,
                "    }",
                "",
            ]
        )

    @property
    def effect(self) -> str:
        """As `--with` takes it."""
        return f"suggestion.py:suggested:{','.join(self.joints)}"

    def json(self) -> dict[str, Any]:
        """As in diagnosis.json."""
        terms = [{"term": t, "value": v} for t, v in zip(self.terms, self.values, strict=True)]
        return {
            "joint": self.joint,
            "joints": list(self.joints),
            "terms": terms,
            "closure": self.closure,
            "code": self.code,
        }

    def __str__(self) -> str:
        parts = [f"{v:+.3g} {t}" for v, t in zip(self.values, self.terms, strict=True)]
        return f"τ({self.joint}) ≈ {' '.join(parts)}"


def suggest(
    table: Table, screen: Screen, null: Null, threshold: np.ndarray, coordinate: int
) -> Suggestion | None:
    """A sparse expression for the residual of one independent coordinate; None if none holds."""
    joint = table.motion.independent[coordinate]
    terms = list(library(table, joint))
    X = np.column_stack([_column(table, screen, joint, term) for term in terms])
    size = np.linalg.norm(X, axis=0)
    felt = np.flatnonzero(size > 0)
    terms, scale = [terms[i] for i in felt], size[felt]
    X = X[:, felt] / scale
    chosen: list[int] = []
    found: Evidence | None = None
    while len(chosen) < MOST:
        tried = _next(screen, X, chosen)
        judged = screen.judge(X[:, [*chosen, tried]])
        gain = (screen.loss - judged.loss).sum(axis=1)
        before = found.difference if found else np.zeros(len(gain))
        if zscore(gain - before) < SURE:
            break
        chosen.append(tried)
        bare = Candidate(create("torque_offset", joint), {}, judged, X[:, chosen], coordinate)
        found = evidence(table, screen, null, threshold, bare)
    if found is None or found.closure < CLOSES or found.beyond < BEYOND:
        return None
    joints = tuple(dict.fromkeys([joint, *(j for i in chosen for j in terms[i].joints)]))
    names = [_renamed(terms[i], joints) for i in chosen]
    values = found.candidate.judged.theta / scale[chosen]
    return Suggestion(joint, joints, tuple(names), tuple(map(float, values)), found.closure)


def _next(screen: Screen, X: np.ndarray, chosen: Sequence[int]) -> int:
    """The term whose addition makes the in-sample error fall most."""
    done = screen.projected(X[:, list(chosen)])
    Q = np.linalg.qr(done)[0] if chosen else np.zeros((len(X), 0))
    rest = screen.projected(X)
    rest = rest - Q @ (Q.T @ rest)
    norms = np.linalg.norm(rest, axis=0)
    score = np.where(norms > 1e-2, np.abs(screen.r @ rest) / np.where(norms > 0, norms, 1), 0.0)
    score[list(chosen)] = 0.0
    return int(score.argmax())


def _column(table: Table, screen: Screen, joint: str, term: Term) -> np.ndarray:
    """The term as a torque of the joint, in the screen's rows (M,)."""
    found = []
    for number in range(len(table.scenes)):
        s = table.samples(number)
        out = np.zeros((*s.shape, 1))
        s.add_torque(out, joint, term.value(s.signals(term.joints))[:, None])
        found.append(table.filtered(number, out))
    return screen.taken(np.concatenate(found))[:, 0]


def library(table: Table, joint: str) -> Iterator[Term]:
    """Terms of one joint's signals, and of it and another's."""
    one = dict(_shapes(0))
    yield Term("1.0", (joint,), lambda s: np.ones(len(s.t)))
    for text, value in one.items():
        yield Term(text, (joint,), value)
    still: dict[str, Column] = {"ca.sign(s.v[0])": lambda s: direction(s.v[:, 0], s.still[0])}
    time: dict[str, Column] = {"s.t": lambda s: s.t - s.t[0]}
    for factors in (still, {"s.v[0]": lambda s: s.v[:, 0]}, time):
        for (a, f), (b, g) in ((x, y) for x in factors.items() for y in one.items()):
            if a != b:
                yield Term(f"{a}*{b}", (joint,), _product(f, g))
    yield Term("s.t", (joint,), time["s.t"])
    for other in (j.name for j in table.mechanism.joints if j.name != joint):
        both = (joint, other)
        for text, value in _shapes(1):
            yield Term(text, both, value)
        for a, f in (("s.q[0]", lambda s: s.q[:, 0]), ("s.v[0]", lambda s: s.v[:, 0])):
            for b, g in (("s.q[1]", lambda s: s.q[:, 1]), ("s.v[1]", lambda s: s.v[:, 1])):
                yield Term(f"{a}*{b}", both, _product(f, g))


def _shapes(i: int) -> Iterator[tuple[str, Column]]:
    """Simple functions of the signals of the i-th joint."""
    yield f"s.q[{i}]", lambda s: s.q[:, i]
    yield f"s.q[{i}]**2", lambda s: s.q[:, i] ** 2
    yield f"s.q[{i}]**3", lambda s: s.q[:, i] ** 3
    yield f"s.v[{i}]", lambda s: s.v[:, i]
    yield f"s.v[{i}]**2", lambda s: s.v[:, i] ** 2
    yield f"s.v[{i}]**3", lambda s: s.v[:, i] ** 3
    yield f"s.a[{i}]", lambda s: s.a[:, i]
    yield f"ca.sign(s.v[{i}])", lambda s: direction(s.v[:, i], s.still[i])
    for k in (1, 2, 3, 4):
        yield f"ca.sin({k}*s.q[{i}])", _wave(np.sin, k, i)
        yield f"ca.cos({k}*s.q[{i}])", _wave(np.cos, k, i)


def _product(f: Column, g: Column) -> Column:
    return lambda s: f(s) * g(s)


def _wave(f: Callable[[np.ndarray], np.ndarray], k: int, i: int) -> Column:
    """f(k q) of the i-th joint."""
    return lambda s: f(k * s.q[:, i])


def _renamed(term: Term, joints: tuple[str, ...]) -> str:
    """The term's text with the other joint's place among the suggestion's joints."""
    if len(term.joints) < 2:
        return term.text
    return term.text.replace("[1]", f"[{joints.index(term.joints[1])}]")
