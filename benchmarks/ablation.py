"""Which constants and rules of the diagnosis pay: each switched off, or halved and doubled.

    python benchmarks/ablation.py [--off] [--rules] [--every 8] [--data DIR] [--only NAME …]
                                  [--results FILE]

Every case is fitted once, and the set of effects is searched again with one constant changed, or
one rule left out, at a time. Right is: a hidden effect is named first (in a loop: named or a
rival); both of two are in the set; no name where nothing, or nothing of the library, is missing. A
real machine has no such truth: there the members of the set that come and go are counted, and the
change of the left-out error.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):  # before numpy
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
from machines import located  # noqa: E402

import ident  # noqa: E402
from ident.diagnosis.candidates import Contest, candidates_of  # noqa: E402
from ident.diagnosis.null import with_noise  # noqa: E402
from ident.diagnosis.search import Selection, select  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "tests" / "battery"))

from cases import Case, cases  # noqa: E402
from generate import make  # noqa: E402
from judge import label, read  # noqa: E402

CATEGORIES = ("visible", "loop", "quarter", "clean", "outside", "two")
COLOURED = ("visible", "clean")  # categories that are judged with coloured noise as well
MACHINES = ("tx40", "panda", "lwr4")
CONSTANTS = {  # module: constants of the search, then those of the rows, which are made anew
    "diagnosis.search": ("COMMON_RATIO", "NEAR", "BEST_TRIED"),
    "diagnosis.selection": (
        "PARSIMONY", "SAME_PART", "NEGATIVE", "STANDS_FOR", "CLOSEST", "STARTS",
    ),
    "diagnosis.null": ("TRIALS",),
    "information.hypotheses": ("PARSIMONY",),
    "diagnosis.candidates": ("STANDS_FOR", "HIDDEN"),
    "faults.small_errors": ("SLOW", "GUARD", "ENOUGH", "WORSE"),
}  # fmt: skip
OFF = {  # values at which a constant has no influence
    "COMMON_RATIO": (0.0,), "NEAR": (0.0,), "BEST_TRIED": (1,), "PARSIMONY": (0.0,),
    "SAME_PART": (-1.0, 1.0), "NEGATIVE": (1e9,), "STANDS_FOR": (0.0,),
    "STARTS": (1,), "HIDDEN": (0.0,), "CLOSEST": (0,),
    "GUARD": (0.0,),
}  # fmt: skip
OF_ROWS = ("diagnosis.candidates", "faults.small_errors")
SHARES = {"SAME_PART", "STANDS_FOR", "NEAR", "ENOUGH"}  # doubled: half way to one
Variant = tuple[str, str, float, bool]  # module, constant, factor or value, whether a value
# a function or a method of diagnosis/, and what leaves it out
RULES: dict[str, Any] = {
    "search.Search.add_group": lambda self, now, ranking: now,
    "search.Search.add_common": lambda self, now: now,
    "search.Search.readmit": lambda self, now: now,
    "search.Search.add_pairs": lambda self, now: None,
    "search.Search.exchanged": lambda self, now: None,
    "search.Search.with_rivals": lambda self, now, member: member,
    "effect_set.EffectSet.polished": lambda self: self,
    "search._credible_without": lambda *_: True,
    "effect_set._past": lambda *_: None,
    "effect_set._curve": lambda *_: None,
    "effect_set._impossible": lambda *_: None,
    "effect_set._beside_best_law": lambda *_: True,
    "effect_set._with_evidence_alone": lambda member, *_: member,
    "selection.differs": lambda *_: True,
    "selection.by_chance": lambda *_: False,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--every", type=int, default=8, help="one case of each category in so many")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="these constants")
    parser.add_argument("--rules", action="store_true", help="leave out rules, not constants")
    parser.add_argument("--off", action="store_true", help="switch off, not halve and double")
    parser.add_argument("--results", type=Path, help="JSON lines, one a case")
    options = parser.parse_args()
    variants = [
        (module, name, factor, options.off)
        for module, names in CONSTANTS.items()
        for name in names
        if not options.only or name in options.only
        for factor in (OFF.get(name, ()) if options.off else (0.5, 2.0))
    ]
    if options.rules:
        variants = [("", name, 0.0, True) for name in RULES
                    if not options.only or name in options.only]  # fmt: skip
    places = [*options.data, Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data"))]
    found = []
    for result in results(variants, options.every, places):
        found.append(result)
        print(f"{len(found)} {result['name']}: {result['sets']['as it is']}", file=sys.stderr)
        if options.results:
            with options.results.open("a") as file:
                print(json.dumps(result), file=file)
    print(table(variants, found))


def results(
    variants: Sequence[Variant], every: int, places: Sequence[Path]
) -> Iterator[dict[str, Any]]:
    """One result a case: by variant whether it is right, or what the set is."""
    for category in CATEGORIES:
        for coloured in (False, True)[: 1 + (category in COLOURED)]:
            mine = [each for each in cases("tuning", 1e-3 if coloured else None)
                    if each.category == category][coloured::every]  # fmt: skip
            for case in mine:
                yield result_of(case, coloured, variants)
    for name in MACHINES:
        module = importlib.import_module(f"machines.{name}")
        source = located(module.SOURCE, places)
        if source is not None:
            with tempfile.TemporaryDirectory() as folder:
                machine = module.convert(source, Path(folder))
                bare = ident.load(machine.mechanism)
                for effect in (*machine.effects, "viscous", "coulomb"):
                    bare = bare.with_effect(effect)
                fit = ident.identify(bare, ident.complete(bare, list(machine.train)))
                yield {"name": name, "category": "real", **searched(fit, None, variants)}


def result_of(case: Case, coloured: bool, variants: Sequence[Variant]) -> dict[str, Any]:
    from dataclasses import replace

    made = make(replace(case, noise=0.03, coloured=True) if coloured else case)
    with tempfile.TemporaryDirectory() as folder:
        mechanism = ident.load(made.folder(Path(folder)))
        fit = ident.identify(mechanism, ident.complete(mechanism, read(made.logs)))
        category = case.category + (" coloured" if coloured else "")
        return {"name": case.name, "category": category, **searched(fit, case, variants)}


def searched(fit: Any, case: Case | None, variants: Sequence[Variant]) -> dict[str, Any]:
    """By variant what is named, and whether that is right."""

    def found(contest: Contest) -> tuple[list[str], bool, float]:
        selection = select(contest, lambda what, share: None)
        loss = selection.last.regression.losses.sum(axis=0) / selection.last.regression.weight**2
        density = float(np.log(np.maximum(loss, 1e-300)).mean()) / 2
        names = [m.label for m in selection.named] if case else [
            m.label for m in selection.members]  # fmt: skip
        return names, right(case, selection), density

    contest = with_noise(Contest.of(fit, candidates_of(fit), lambda what, share: None))
    result = {"as it is": found(contest)}
    for variant in variants:
        with changed(variant):
            other = contest
            if variant[0] in OF_ROWS:
                other = with_noise(Contest.of(fit, candidates_of(fit), lambda what, share: None))
            result[text(variant)] = found(other)
    return {"sets": result}


def right(case: Case | None, selection: Selection) -> bool:
    named = selection.named
    if case is None or case.category in ("clean", "outside"):
        return not named
    hidden = {label(each) for each in case.hidden}
    if case.category == "two":
        return hidden <= {m.label for m in selection.members}
    rivals = {e.effect.label for e in named[0].rivals} if named else set()
    first = {named[0].label} if named else set()
    return bool(hidden & (first | rivals if case.category == "loop" else first))


@contextmanager
def changed(variant: Variant) -> Iterator[None]:
    """One constant of the diagnosis with another value, wherever it is imported."""
    module, constant, factor, absolute = variant
    if not module:
        with without(constant):
            yield
        return
    value = getattr(importlib.import_module(f"ident.{module}"), constant)
    new = factor * value if factor < 1 or constant not in SHARES else 0.5 * (1 + value)
    new = factor if absolute else new
    mine = [
        m
        for n, m in sys.modules.items()
        if n.startswith(("ident.diagnosis.", "ident.faults.small_errors", "ident.information.hypo"))
    ]
    places = [m for m in mine if getattr(m, constant, None) == value]
    for place in places:
        setattr(place, constant, type(value)(new) if absolute or new >= 1 else new)
    try:
        yield
    finally:
        for place in places:
            setattr(place, constant, value)


@contextmanager
def without(rule: str) -> Iterator[None]:
    """The diagnosis without one rule, wherever it is imported."""
    module, *path = rule.split(".")
    mine = [m for n, m in sys.modules.items() if n.startswith("ident.diagnosis.")]
    owner = importlib.import_module(f"ident.diagnosis.{module}")
    own = getattr(owner, path[0])
    places = [own] if path[1:] else [m for m in mine if getattr(m, path[0], None) is own]
    before = getattr(places[0], path[-1])
    for place in places:
        setattr(place, path[-1], RULES[rule])
    try:
        yield
    finally:
        for place in places:
            setattr(place, path[-1], before)


def text(variant: Variant) -> str:
    module, constant, factor, absolute = variant
    if not module:
        return f"without {constant}"
    return f"{module.partition('.')[2]}.{constant} {'=' if absolute else '×'} {factor:g}"


def table(variants: Sequence[Variant], found: Sequence[dict[str, Any]]) -> str:
    """Markdown: how many cases of each category are right; of real machines what changes."""
    judged = list(dict.fromkeys(r["category"] for r in found if r["category"] != "real"))
    real = [r for r in found if r["category"] == "real"]
    head = ["constant", *judged, *(r["name"] for r in real)]
    lines = [" | ".join(["", *head, ""]).strip(), "|" + "---|" * len(head)]
    for variant in ["as it is", *map(text, variants)]:
        cells = [variant]
        for category in judged:
            mine = [r["sets"][variant][1] for r in found if r["category"] == category]
            cells.append(f"{sum(mine)}/{len(mine)}")
        for r in real:
            (before, _, old), (after, _, new) = r["sets"]["as it is"], r["sets"][variant]
            come, go = len(set(after) - set(before)), len(set(before) - set(after))
            cells.append(
                f"{len(before)} effects" if variant == "as it is"
                else f"+{come} −{go}, {100 * np.expm1(new - old):+.1f} %" if come or go else "–"
            )  # fmt: skip
        lines.append(" | ".join(["", *cells, ""]).strip())
    return "\n".join(lines)


if __name__ == "__main__":
    main()
