"""A sparse expression of the signals for a residual that no effect of the library explains.

    residual of joint j ≈ Σ c_i f_i(q, v, a, t)      f_i: products of powers, sines and signs

Terms are added one by one, everything else refitted, as long as each is credible by the rule of
evidence among all terms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.diagnosis.candidates import Contest
from ident.diagnosis.null import SURROGATES, NoiseDraws, judging
from ident.diagnosis.selection import Decision, Ranking
from ident.effects import Signals
from ident.effects.friction import direction
from ident.information.hypotheses import Array, quantile

MOST = 3  # terms
LEAST = 0.5  # share of what exceeds the noise that an expression must explain to be proposed
Column = Callable[[Signals], Array]


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
        explained: share of the left-out squares beyond the noise that it explains.
    """

    joint: str
    joints: tuple[str, ...]
    terms: tuple[str, ...]
    values: tuple[float, ...]
    explained: float

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
        """Name by which `--with` takes it."""
        return f"suggestion.py:suggested:{','.join(self.joints)}"

    def json(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        terms = [{"term": t, "value": v} for t, v in zip(self.terms, self.values, strict=True)]
        return {
            "joint": self.joint,
            "joints": list(self.joints),
            "terms": terms,
            "explained": self.explained,
            "code": self.code,
        }

    def __str__(self) -> str:
        parts = [f"{v:+.3g} {t}" for v, t in zip(self.values, self.terms, strict=True)]
        return f"τ({self.joint}) ≈ {' '.join(parts)}"


def suggest(
    contest: Contest, last: Ranking, noise: NoiseDraws, decision: Decision, seed: int
) -> Suggestion | None:
    """A sparse expression for what the model leaves of its worst coordinate; None if none holds."""
    regression = contest.regression
    beyond = (
        regression.losses.sum(axis=0) - regression.rows * (noise.floor * regression.weight) ** 2
    )
    u = int(beyond.argmax())
    joint = contest.fit.motion.independent[u]
    terms = list(_terms(contest, joint))
    columns = _columns(contest, joint, terms)
    felt = np.flatnonzero(np.any([c.any(axis=0) for c in columns], axis=0))
    contest, new = contest.added([c[:, felt] for c in columns])
    regression = contest.regression
    chosen: list[int] = []
    while len(chosen) < MOST:
        regression = judging(contest, regression, noise, seed)
        found = regression.gains([new[i : i + 1] for i in range(len(new))])
        best = int(found.G.argmax())
        total = float(regression.loss.sum())
        null = found.null / np.maximum(regression.null_loss, total)
        if found.G[best] <= total * quantile(null[:, :SURROGATES], decision.alpha):
            break
        chosen.append(best)
        regression = regression.extended(new[best : best + 1])
    if not chosen:
        return None
    fall = contest.regression.losses.sum(axis=0)[u] - regression.losses.sum(axis=0)[u]
    explained = float(np.clip(fall / max(float(beyond[u]), 1e-300), 0.0, 1.0))
    if explained < LEAST:
        return None
    values = regression.theta[-len(chosen) :]
    mine = [terms[felt[i]] for i in chosen]
    joints = tuple(dict.fromkeys([joint, *(name for term in mine for name in term.joints)]))
    names = tuple(_renamed(term, joints) for term in mine)
    return Suggestion(joint, joints, names, tuple(map(float, values)), explained)


def _columns(contest: Contest, joint: str, terms: list[Term]) -> list[Array]:
    """The terms as torques of the joint (m, terms) in the rows of each part."""
    table, found = contest.table, []
    for number in range(len(table.scenes)):
        s = table.samples[number]
        out = np.zeros((*s.shape, len(terms)))
        s.add_torque(out, joint, np.stack([t.value(s.signals(t.joints)) for t in terms], axis=1))
        found.append(table.filtered(number, out))
    C = np.concatenate(found)
    return [C[contest.use[:, p.coordinate], p.coordinate] for p in contest.regression.parts]


def _terms(contest: Contest, joint: str) -> Iterator[Term]:
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
    for other in (j.name for j in contest.table.mechanism.joints if j.name != joint):
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


def _wave(f: Callable[[Array], Array], k: int, i: int) -> Column:
    """f(k q) of the i-th joint."""
    return lambda s: f(k * s.q[:, i])


def _renamed(term: Term, joints: tuple[str, ...]) -> str:
    """The term's text with the other joint's place among the suggestion's joints."""
    if len(term.joints) < 2:
        return term.text
    return term.text.replace("[1]", f"[{joints.index(term.joints[1])}]")
