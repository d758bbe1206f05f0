"""Effects in plain words, with the name by which commands and files have them behind.

`dry friction in joint1 to joint3 (coulomb)`: the same words in a diagnosis, a ladder, a comparison
and the page of `explore`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ident.effects import Effect
from ident.text import listed, places

PREPOSITIONS = {"link": "on", "place": "at"}  # by site; of joints and closures: in


def by_kind(effects: Iterable[Effect]) -> list[list[Effect]]:
    """Return effects of one kind together, in the order of the first of each."""
    found: dict[str, list[Effect]] = {}
    for effect in effects:
        found.setdefault(effect.kind, []).append(effect)
    return list(found.values())


def named(effects: Iterable[Effect], word: str = "and") -> str:
    """Return effects in words, those of one kind together: `dry friction in a3 to a7 (coulomb)`."""
    return listed([_of_one_kind(group, word) for group in by_kind(effects)], word)


def plain(effect: Effect) -> str:
    """Return the words for an effect's kind."""
    return effect.plain or effect.kind.replace("_", " ")


def _of_one_kind(group: Sequence[Effect], word: str) -> str:
    first = group[0]
    signals = listed(dict.fromkeys(each.signal for each in group if each.signal))
    of = f" of {signals}" if any(each.signal for each in group) else ""
    sites = first.joints if len(group) == 1 else [",".join(each.joints) for each in group]
    own = places(sites) if word == "and" else listed(sites, word)  # of rivals the best first
    where = f" {PREPOSITIONS.get(first.site, 'in')} {own}" if first.joints else ""
    code = "" if first.kind.replace("_", " ") in plain(first) else f" ({first.kind})"
    return f"{plain(first)}{of}{where}{code}"
