"""The scores of the battery, from results alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from cases import FULL_MOTION

Result = dict[str, Any]
Effect = tuple[str, frozenset[str]]
NEAR = 0.10  # a parameter's error, and an error's excess over the noise


@dataclass(frozen=True)
class Score:
    """A line of the table: the share of `items` that pass must be at least `target`."""

    title: str
    target: float
    categories: tuple[str, ...]
    items: Callable[[Result], Iterator[bool]]

    def of(self, results: Sequence[Result]) -> list[tuple[Result, bool]]:
        """Every item with the result that it comes from; a crash fails once."""
        found = []
        for r in results:
            if r["category"] in self.categories:
                passed = [False] if "error" in r else list(self.items(r))
                found += [(r, each) for each in passed]
        return found


def effect(told: Result) -> Effect:
    """What must agree: kind and joints, in any order; a tilt of the base has no joint."""
    kind = told["effect"]
    return kind, frozenset() if kind == "gravity_tilt" else frozenset(told["joints"])


def hidden(r: Result) -> set[Effect]:
    return {effect(h) for h in r["hidden"]}


def named(r: Result) -> Effect | None:
    """The effect named first, if one is said to be missing."""
    if r["verdict"] != "missing":
        return None
    told = r["best"] or (r["candidates"][0] if r["candidates"] else None)
    return effect(told) if told else None


def candidates(r: Result) -> set[Effect]:
    """The effect named first and its rivals."""
    first = named(r)
    rivals = {effect(rival) for c in r["candidates"] if effect(c) == first for rival in c["rivals"]}
    return rivals | {first} if first else set()


def first(r: Result) -> Iterator[bool]:
    yield named(r) in hidden(r)


def first_in_full_motion(r: Result) -> Iterator[bool]:
    if r["mechanism"] in FULL_MOTION:
        yield named(r) in hidden(r)


def in_the_set(r: Result) -> Iterator[bool]:
    yield bool(hidden(r) & candidates(r))


def nothing(r: Result) -> Iterator[bool]:
    yield r["verdict"] == "nothing"


def unnamed(r: Result) -> Iterator[bool]:
    """Something is left, and no name: `undecided` where the log cannot tell it from noise."""
    yield r["verdict"] in ("unexplained", "undecided")


def not_alone(r: Result) -> Iterator[bool]:
    joints = {joint for _, joints in candidates(r) for joint in joints}
    yield r["verdict"] != "missing" or len(joints) > 1


def both(r: Result) -> Iterator[bool]:
    yield hidden(r) <= {effect(told) for told in r["added"]}


def exactly(r: Result) -> Iterator[bool]:
    yield len(r["added"]) == len(r["hidden"])


def said(r: Result) -> Iterator[bool]:
    """Listed as invisible, and nothing else is named in its place."""
    yield hidden(r) <= {effect(told) for told in r["invisible"]} and r["verdict"] != "missing"


def parameters(r: Result) -> Iterator[bool]:
    for name, (true, value, stderr) in r.get("parameters", {}).items():
        # a gain g of the measured torque is 1 + g, or 1/(1 − g) if it multiplies what is measured
        truths = (true, true / (1 + true)) if name.startswith("torque_gain") else (true,)
        yield any(abs(value - x) <= max(NEAR * abs(x), 2 * stderr) for x in truths)


def at_the_noise(r: Result) -> Iterator[bool]:
    if r.get("held_out"):
        yield all(rms <= (1 + NEAR) * clean for rms, clean in r["held_out"].values())


ADDED = ("visible", "loop", "quarter", "two")
SCORES = (
    Score("visible on serial arms: named first, right joint", 0.95, ("visible",), first),
    Score("closed loops: true effect in the set of rivals", 0.98, ("loop",), in_the_set),
    Score("closed loops in full motion: named first", 0.85, ("loop",), first_in_full_motion),
    Score("clean: verdict `nothing`", 0.95, ("clean",), nothing),
    Score("outside the library: no name, and not `nothing`", 0.90, ("outside",), unnamed),
    Score("parallelogram: never one joint alone", 1.00, ("parallelogram",), not_alone),
    Score("a quarter of the size: named first", 0.85, ("quarter",), first),
    Score("a quarter of the size: in the set", 0.97, ("quarter",), in_the_set),
    Score("two effects: both found", 0.90, ("two",), both),
    Score("two effects: exactly two, then stop", 0.85, ("two",), exactly),
    Score("invisible or absorbed: said to be so", 0.95, ("invisible",), said),
    Score("parameter within 10 % or two standard errors", 0.90, ADDED, parameters),
    Score("true effect added: held-out error within 10 % of noise", 0.95, ADDED, at_the_noise),
)


def table(results: Sequence[Result]) -> str:
    """Markdown, one line a score."""
    lines = ["| score | target | passed | of | share | |", "|---|---|---|---|---|---|"]
    for score in SCORES:
        items = score.of(results)
        if not items:
            continue
        passed = sum(ok for _, ok in items)
        share = passed / len(items)
        mark = "met" if share >= score.target else "**missed**"
        lines.append(
            f"| {score.title} | ≥ {score.target:.0%} | {passed} | {len(items)} | {share:.1%} "
            f"| {mark} |"
        )
    return "\n".join(lines)


def failures(results: Sequence[Result]) -> str:
    """Every item that failed, with what was said instead."""
    lines = []
    for score in SCORES:
        for r, ok in score.of(results):
            if not ok:
                lines.append(f"{score.title}: {r['name']} ({r['noise']:.0%}): {instead(r)}")
    return "\n".join(lines)


def instead(r: Result) -> str:
    if "error" in r:
        return str(r["error"]).strip().splitlines()[-1]
    what = ", ".join(f"{kind}:{','.join(sorted(js))}" for kind, js in sorted(
        candidates(r), key=lambda each: each != named(r)))  # fmt: skip
    grown = "".join(f" + {e['effect']}:{','.join(e['joints'])}" for e in r.get("added", []))
    return f"{r['verdict']} [{what}]{grown and ' grown' + grown}"
