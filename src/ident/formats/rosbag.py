"""ROS 2 bags to a table: which topics, which clock, and one row for each time.

A bag is a folder with a metadata.yaml, or one `.mcap` or `.db3` file. `rosbags` reads all three and
is imported here alone; its own data frames need pandas and know no messages of varying joints.
Joint states have one definition in every ROS 2, so the bag's own is not used.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from ident.errors import LogError, one_of
from ident.files import check_size, most_bytes
from ident.log.table import RawTable, check_name

JOINTS = "sensor_msgs/JointState"
LARGEST = 20_000_000  # work: messages; at 1 kHz five hours
Groups = Mapping[tuple[str, tuple[str, ...]], pl.DataFrame]
"""By topic and columns: received, stamp [ns] (0: none) and the values [SI] of each message."""


def read_bag(path: Path, topics: Sequence[str] = ()) -> RawTable:
    """Read the joint states of a bag.

    Several `topics` are merged; none stands for the only one. The columns are `t` [s] since the
    first message and q., v., tau. of the names in the bag.
    """
    try:
        from rosbags.rosbag2 import Reader
    except ImportError:
        raise LogError(
            f'{path}: reading ROS bags needs the package rosbags: pip install "ident[ros]"'
        ) from None
    from ident.formats.bag_sizes import check_expansion

    check_expansion(path)
    try:
        with Reader(path) as bag:
            connections = _chosen(bag.connections, topics, str(path))
            return _merged(str(path), _messages(bag, connections, str(path)))
    except (LogError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # a parser given anything: every fault is the file's
        what = " ".join(str(error).split())[:200]
        raise LogError(
            f"{path}: no ROS 2 bag, or a damaged one ({what or type(error).__name__}); if its "
            "recording was cut off, `ros2 bag reindex` or `mcap recover` may repair it"
        ) from None


def _chosen(connections: Sequence[Any], topics: Sequence[str], file: str) -> list[Any]:
    kinds = {connection.topic: _kind(connection) for connection in reversed(connections)}
    joints = [topic for topic, kind in kinds.items() if kind == JOINTS]
    for topic in topics:
        if topic not in kinds:
            raise LogError(f"{file}: no topic '{topic}'; {one_of(topic, joints)}")
        if topic not in joints:
            raise LogError(f"{file}: topic '{topic}' holds {kinds[topic]}; valid: {JOINTS}")
    if not joints:
        topics = ", ".join(sorted({f"{t} ({kind})" for t, kind in kinds.items()})[:8])
        raise LogError(f"{file}: no topic of {JOINTS}; it holds: {topics or 'no topic'}")
    filled = {connection.topic for connection in connections if connection.msgcount}
    wanted = list(topics)
    if not wanted:
        wanted = [topic for topic in joints if topic in filled] or joints
        if len(wanted) > 1:
            raise LogError(
                f"{file}: several topics hold joint states: {', '.join(sorted(wanted))}; name one, "
                f"{file}#{min(wanted)}, or several, to be merged, with commas between"
            )
    return [connection for connection in connections if connection.topic in wanted]


def _kind(connection: Any) -> str:
    return str(connection.msgtype).replace("/msg/", "/")


def _messages(bag: Any, connections: list[Any], file: str) -> Groups:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    number: Counter[str] = Counter()
    values_read, most = 0, most_bytes() // 8
    arrays: dict[Any, tuple[array[int], array[int], array[float]]]
    arrays = defaultdict(lambda: (array("q"), array("q"), array("d")))
    for count, (connection, received, raw) in enumerate(bag.messages(connections=connections)):
        if count >= LARGEST:
            raise LogError(f"{file}: more than {LARGEST} messages; cut the bag into several logs")
        topic = connection.topic
        number[topic] += 1
        message: Any = store.deserialize_cdr(raw, _kind(connection).replace("/", "/msg/"))
        place = f"{file}: topic {topic}, message {number[topic]}"
        filled = _content(message, place)
        times, stamps, numbers = arrays[topic, tuple(filled), tuple(message.name)]
        times.append(received)
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for values in filled.values():
            numbers.extend(map(float, values))
            values_read += len(values)
        if values_read > most:
            check_size(Path(file), 8 * values_read)
    groups = {}
    for (topic, keys, names), (received, stamps, values) in arrays.items():
        columns = tuple(f"{key}.{name}" for key in keys for name in names)
        table = np.array(values).reshape(len(stamps), len(columns))
        series = [pl.Series("received", received, pl.Int64), pl.Series("stamp", stamps, pl.Int64)]
        series += [pl.Series(name, x) for name, x in zip(columns, table.T, strict=True)]
        if columns:
            groups[topic, columns] = pl.DataFrame(series).fill_nan(None)
    return groups


def _content(message: Any, place: str) -> dict[str, Sequence[float]]:
    """Return the arrays of a message that hold values, by their prefix in a log."""
    arrays = {"q": message.position, "v": message.velocity, "tau": message.effort}
    filled = {key: x for key, x in arrays.items() if len(x)}
    for key, x in filled.items():
        if len(x) != len(message.name):
            what = {"q": "positions", "v": "velocities", "tau": "efforts"}[key]
            raise LogError(
                f"{place}: {len(message.name)} names and {len(x)} {what}; every array "
                "has one value a name, or is empty"
            )
    if "" in message.name or len(set(message.name)) < len(message.name):
        names = ", ".join(map(repr, message.name))
        raise LogError(f"{place}: the names {names}; each joint needs its own")
    return filled


def _merged(file: str, groups: Groups) -> RawTable:
    """Return one row for every time of a joint state; empty where a joint has no value then."""
    notes = []
    if not groups:
        raise LogError(f"{file}: no message of joint states with a value in it")
    none = sum(int((table["stamp"] == 0).sum()) for table in groups.values())
    if none:
        notes.append(
            f"{none} of {sum(map(len, groups.values()))} messages have no stamp: t is when "
            "messages were received, which jitters more"
        )
    timed = {
        key: table.with_columns(pl.col("received" if none else "stamp").alias("t"))
        for key, table in groups.items()
    }
    _check_topics(timed, file)
    both = pl.concat([table.drop("received", "stamp") for table in timed.values()], how="diagonal")
    count = both.group_by("t").agg(pl.all().count()).drop("t")
    repeated = int((count.max_horizontal().cast(pl.Int64) - 1).clip(0).sum())
    if repeated:
        notes.append(f"{repeated} messages repeat the stamp of another: one of each kept")
    rows = both.group_by("t").agg(pl.all().drop_nulls().first()).sort("t")
    if len({frozenset(columns) for _, columns in groups}) > 1:
        notes.append(
            f"messages hold {len(groups)} different sets of columns, merged: {len(rows)} times, "
            "empty cells where a joint says nothing"
        )
    t = rows["t"].to_numpy()
    columns = {name: rows[name].to_numpy() for name in rows.columns if name != "t"}
    notes.append(f"t counts from the first message, {_seconds(t[0])} s of its clock")
    for name in columns:
        check_name(file, name)
    return RawTable(file, {"t": (t - t[0]) / 1e9, **columns}, {}, tuple(notes))


def _check_topics(timed: Groups, file: str) -> None:
    topic_of: dict[str, str] = {}
    for topic, columns in timed:
        for name in columns:
            other = topic_of.setdefault(name, topic)
            if other != topic:
                raise LogError(
                    f"{file}: topics {other} and {topic} both hold '{name}'; name one of them"
                )
    for name, topic in topic_of.items():
        parts = [table for (_, columns), table in timed.items() if name in columns]
        at = pl.concat([table.select("received", "t") for table in parts])
        times = at.sort("received", maintain_order=True)["t"].to_numpy()
        back = np.flatnonzero(np.diff(times) < 0)
        if len(back):
            raise LogError(
                f"{file}: topic {topic}: stamps of '{name}' go backward: "
                f"{_seconds(times[back[0] + 1])} s after {_seconds(times[back[0]])} s (a clock "
                "reset, or two nodes that publish the same joints?); cut the bag there, or record "
                "one of them"
            )


def _seconds(time: np.int64) -> str:
    return f"{int(time) // 10**9}.{int(time) % 10**9:09d}"  # float64 has no room for nanoseconds
