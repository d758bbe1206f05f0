"""Messages, each at its own time, to one table with one row a time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ident.errors import LogError
from ident.log.cells import Array
from ident.log.messages import Message, Rows
from ident.log.table import Table, check_name

GAP = 5.0  # median steps between two wrenches beyond which nothing is interpolated


def merged(file: str, messages: Iterable[Message], notes: Iterable[str] = ()) -> Table:
    """One row for every time at which joints spoke; empty where one of them did not.

    Wrenches are interpolated at these times, which is what is done to any column of another rate
    later on; a clock of both together would be neither's.

    Args:
        file: what messages call it.
        messages: in the order of recording.
        notes: said before those of the merging.

    Raises:
        LogError: for no message of joints, a message that contradicts itself, and stamps of one
            topic that go backward.
    """
    rows: dict[tuple[str, tuple[str, ...]], Rows] = {}
    for message in messages:
        key = (message.topic, message.columns)
        each = rows.get(key) or rows.setdefault(key, Rows(*key))
        each.received.append(message.received)
        each.stamps.append(message.stamp)
        each.values.extend(message.values)
    filled = [each for each in rows.values() if each.columns]
    joints = [each for each in filled if not each.columns[0].startswith("wrench.")]
    wrenches = [each for each in filled if each not in joints]
    if not joints:
        raise LogError(f"{file}: no message of joint states with a value in it")
    said = [*notes]
    times = _times([*joints, *wrenches], file, said)
    t, columns = _side_by_side(joints, times[: len(joints)], file, said)
    for each, at in zip(wrenches, times[len(joints) :], strict=True):
        columns |= _between(each, at, t, columns, file, said)
    said.append(f"t counts from the first message, {_seconds(t[0])} s of its clock")
    seconds = (t - t[0]) / 1e9
    for name in columns:
        check_name(file, name)
    return Table(file, {"t": seconds, **columns}, {}, tuple(said))


def _times(rows: list[Rows], file: str, said: list[str]) -> list[NDArray[np.int64]]:
    """Each message's time [ns]: its stamp, or for all when they were received, if one has none."""
    none = sum(r.stamps.count(0) for r in rows)
    if none:
        total = sum(len(r.stamps) for r in rows)
        said.append(
            f"{none} of {total} messages have no stamp: t is when messages were received, which "
            "jitters more"
        )
    times = [np.array(r.received if none else r.stamps, dtype=np.int64) for r in rows]
    spoken: dict[tuple[str, str], list[int]] = {}
    for i, each in enumerate(rows):
        for name in each.columns:
            spoken.setdefault((each.topic, name), []).append(i)
    for (topic, name), parts in spoken.items():
        received = np.concatenate([rows[i].received for i in parts])
        at = np.concatenate([times[i] for i in parts])[np.argsort(received, kind="stable")]
        back = np.diff(at) < 0
        if back.any():
            k = int(back.argmax()) + 1
            raise LogError(
                f"{file}: topic {topic}: stamps of '{name}' go backward: {_seconds(at[k])} s after "
                f"{_seconds(at[k - 1])} s (a clock reset, or two nodes that publish the same "
                "joints?); cut the bag there, or record one of them"
            )
    return times


def _seconds(time: np.int64) -> str:
    return f"{int(time) // 10**9}.{int(time) % 10**9:09d}"  # float64 has no room for nanoseconds


def _side_by_side(
    rows: list[Rows], times: list[NDArray[np.int64]], file: str, said: list[str]
) -> tuple[NDArray[np.int64], dict[str, Array]]:
    t = np.unique(np.concatenate(times))
    columns: dict[str, Array] = {}
    topic_of: dict[str, str] = {}
    repeated = 0
    for each, at in zip(rows, times, strict=True):
        repeated += len(at) - len(np.unique(at))
        clashes = 0
        place = np.searchsorted(t, at)[::-1]  # of several, the last assignment stays: the first
        for name, x in zip(each.columns, each.table().T[:, ::-1], strict=True):
            other = topic_of.setdefault(name, each.topic)
            if other != each.topic:
                raise LogError(
                    f"{file}: topics {other} and {each.topic} both hold '{name}'; name one of them"
                )
            column = columns.setdefault(name, np.full(len(t), np.nan))
            fresh = np.full(len(t), np.nan)
            fresh[place] = x
            empty = np.isnan(column)
            clashes = max(clashes, int((~empty & ~np.isnan(fresh)).sum()))
            column[empty] = fresh[empty]
        repeated += clashes
    if repeated:
        said.append(f"{repeated} messages repeat the stamp of another: one of each kept")
    if len({frozenset(r.columns) for r in rows}) > 1:
        said.append(
            f"messages hold {len(rows)} different sets of columns, merged: {len(t)} times, empty "
            "cells where a joint says nothing"
        )
    return t, columns


def _between(
    rows: Rows,
    at: NDArray[np.int64],
    t: NDArray[np.int64],
    columns: dict[str, Array],
    file: str,
    said: list[str],
) -> dict[str, Array]:
    """A topic's wrenches at the times t, empty where none was measured near."""
    if rows.columns[0] in columns:
        raise LogError(f"{file}: two topics hold '{rows.columns[0]}'; name one of them")
    at, first = np.unique(at, return_index=True)
    if len(at) < 2:
        raise LogError(f"{file}: topic {rows.topic} holds {len(at)} wrench; two are needed")
    step = float(np.median(np.diff(at)))
    right = np.clip(np.searchsorted(at, t), 1, len(at) - 1)
    apart = (at[right] - at[right - 1] > GAP * step) & ~np.isin(t, at)
    empty = (t < at[0]) | (t > at[-1]) | apart
    seconds, known = (t - t[0]) / 1e9, (at - t[0]) / 1e9
    said.append(
        f"topic {rows.topic} ({1e9 / step:.4g} Hz) is interpolated at the times of the joint states"
    )
    return {
        name: np.where(empty, np.nan, np.interp(seconds, known, x))
        for name, x in zip(rows.columns, rows.table()[first].T, strict=True)
    }
