"""All entries of [log] for a log whose columns have other names, ready to be copied.

Columns of one kind differ by a number or by the name of a joint alone. There are as many of them as
joints, or as drives, and they are in the order of those; units are read from the names' ends.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence

from ident.log.log import ORDERED, TIME_NAME, WORDS

NUMBER = re.compile(r"\d+")
RATE = r"(_per_s|/s|_s|ps|s)?"  # what a unit ends with where it is of a speed
ALONE = r"(?<![a-z])"
SCALES = (  # ends of names, factor to SI units, what the comment says
    (re.compile(rf"{ALONE}deg(rees?)?{RATE}$", re.I), math.pi / 180, "degrees to rad"),
    (re.compile(rf"{ALONE}mrad{RATE}$", re.I), 1e-3, "mrad to rad"),
    (re.compile(rf"{ALONE}mm{RATE}$", re.I), 1e-3, "mm to m"),
    (re.compile(rf"{ALONE}cm{RATE}$", re.I), 1e-2, "cm to m"),
    (re.compile(rf"{ALONE}rpm$", re.I), math.pi / 30, "rev/min to rad/s"),
    (re.compile(rf"{ALONE}mN[ ._·*]?m$", re.I), 1e-3, "mN m to N m"),
    (re.compile(rf"{ALONE}mA$", re.I), 1e-3, "mA to A; times the drive's N m/A"),
    (re.compile(rf"{ALONE}A$"), 1.0, "A; times the drive's N m/A"),
    (re.compile(rf"{ALONE}(rad(ians?)?|m){RATE}$", re.I), 1.0, ""),
    (re.compile(rf"{ALONE}N([ ._·*]?m)?$", re.I), 1.0, ""),
)
NO_UNIT = {
    "q": "no unit in its name: rad or m, else give a scale",
    "v": "no unit in its name: rad/s or m/s, else give a scale",
    "tau": "no unit in its name: N m or N, else give a scale",
}
TIMES = (
    (re.compile(r"(?<![a-z])(ms|msec|millis)$", re.I), 1e-3, "ms to s"),
    (re.compile(r"(?<![a-z])(us|usec|micros)$", re.I), 1e-6, "µs to s"),
    (re.compile(r"(?<![a-z])(ns|nsec|nanos)$", re.I), 1e-9, "ns to s"),
)


def suggested_entries(
    columns: Sequence[str], joints: Sequence[str], drives: Sequence[str]
) -> list[str]:
    """Return the lines of [log] that columns suggest for t, positions, speeds and torques, its head
    first; none where positions of all joints and torques of all drives are not found, or one entry
    is all that is lacking.

    >>> suggested_entries(["time_ms", "m1_deg", "m1_pos_deg", "m1_mNm"], ["a"], ["a"])[1]
    '"t" = { column = "time_ms", scale = 0.001 }  # ms to s'
    """
    free = [name for name in columns if name != "t"]
    lines = []
    if "t" not in columns:
        named = [name for name in free if TIME_NAME.search(name)]
        if not named:
            return []
        lines.append(_line("t", named[0], TIMES))
        free.remove(named[0])
    for signal, sites in (("q", joints), ("v", joints), ("tau", drives)):
        if all(f"{signal}.{site}" in columns for site in sites):
            continue
        of = columns_of(signal, sites, free)
        if not of and signal != "v":
            return []
        lines += [_line(f"{signal}.{site}", column, SCALES) for site, column in of.items()]
        free = [name for name in free if name not in of.values()]
    return ["[log]", *lines] if lines[1:] else []  # one alone is in the message


def columns_of(signal: str, sites: Sequence[str], columns: Sequence[str]) -> Mapping[str, str]:
    """Return the columns of a signal by joint: those that have the joints' names, or else as many
    numbered ones as there are joints, in their order; empty where neither is found.
    """
    known = {"tau": re.compile(rf"{WORDS['tau'].pattern}|m?Nm$|m?A$", re.I)}.get(
        signal, WORDS[signal]
    )
    usable = [x for x in columns if known.search(_bare(x)) and not ORDERED.search(x)]
    by_pattern: dict[str, dict[str, str]] = {}
    for name in usable:
        for site in sites:
            if re.search(rf"(?<![A-Za-z]){re.escape(site)}(?![A-Za-z0-9])", name):
                by_pattern.setdefault(name.replace(site, "*"), {})[site] = name
    for named in by_pattern.values():
        if len(named) == len(sites):
            return {site: named[site] for site in sites}
    numbered: dict[str, list[str]] = {}
    for name in usable:
        if len(NUMBER.findall(name)) == 1:
            numbered.setdefault(NUMBER.sub("*", name), []).append(name)
    for group in numbered.values():
        if len(group) == len(sites):
            group.sort(key=lambda name: int(NUMBER.findall(name)[0]))
            return dict(zip(sites, group, strict=True))
    return {}


def _bare(column: str) -> str:
    """Return a column's name without the brackets that its unit is in, as "q1 deg" of "q1 [deg]".

    >>> _bare("current_1(mA)")
    'current_1 mA'
    """
    return re.sub(r"\s*[\[({]([^\[({]*)[\])}]\s*$", r" \1", column).strip()


def _line(name: str, column: str, scales: Sequence[tuple[re.Pattern[str], float, str]]) -> str:
    quoted = json.dumps(column, ensure_ascii=False)  # a TOML basic string too
    bare = _bare(column)
    for pattern, scale, words in scales:
        if pattern.search(bare):
            entry = quoted if scale == 1.0 else f"{{ column = {quoted}, scale = {scale!r} }}"
            return f'"{name}" = {entry}' + f"  # {words}" * bool(words)
    without = NO_UNIT.get(name.partition(".")[0], "")
    return f'"{name}" = {quoted}' + f"  # {without}" * bool(without)
