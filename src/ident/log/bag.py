"""ROS 2 bags to a table: which topics, which clock, and what of a damaged bag can be said.

A bag is a folder with a metadata.yaml, or one `.mcap` or `.db3` file. `rosbags` reads all three and
is imported here alone. Both message types have one definition in every ROS 2: what a bag says of
them is not asked.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from ident.errors import LogError, one_of
from ident.log.merge import merged
from ident.log.messages import BadMessage, Message, joint_columns, wrench_columns
from ident.log.table import Table

SUFFIXES = (".mcap", ".db3")
JOINTS, WRENCH = "sensor_msgs/JointState", "geometry_msgs/WrenchStamped"
LARGEST = 20_000_000  # messages; at 1 kHz five hours


def is_bag(path: Path) -> bool:
    """Whether a path names a ROS 2 bag."""
    return (path / "metadata.yaml").is_file() or path.suffix.lower() in SUFFIXES


def bag_digest(path: Path) -> str:
    """SHA-256 of the bag's data, of a folder its storage files in order of their names."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if set(file.suffixes) & set(SUFFIXES):
            with file.open("rb") as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
    return digest.hexdigest()


def read_bag(path: Path, topics: Sequence[str] = ()) -> Table:
    """The joint states of a bag, and the wrenches that are asked for.

    Args:
        path: of the folder or file.
        topics: of joint states (several are merged) and of wrenches; none: the only topic of joint
            states.

    Returns:
        Columns `t` [s] since the first message and q., v., tau., wrench. of the names in the bag.

    Raises:
        LogError: if rosbags is not installed, the bag is damaged, has no joint states or several
            topics of them, or a message contradicts itself or the clock.
    """
    try:
        from rosbags.rosbag2 import Reader
    except ImportError:
        raise LogError(
            f'{path}: reading ROS bags needs the package rosbags: pip install "ident[ros]"'
        ) from None
    try:
        with Reader(path) as reader:
            chosen, notes = _chosen(reader.connections, topics, str(path))
            return merged(str(path), _decoded(reader, chosen, str(path)), notes)
    except (LogError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # a parser given anything: every fault is the file's
        what = " ".join(str(error).split())[:200]
        raise LogError(
            f"{path}: no ROS 2 bag, or a damaged one ({what or type(error).__name__}); if its "
            "recording was cut off, `ros2 bag reindex` or `mcap recover` may mend it"
        ) from None


def _chosen(
    connections: Sequence[Any], topics: Sequence[str], file: str
) -> tuple[list[Any], list[str]]:
    """The connections to read, and what is left out, in words."""
    kinds: dict[str, str] = {}
    for each in connections:
        kinds.setdefault(each.topic, _kind(each))
    joints = [topic for topic, kind in kinds.items() if kind == JOINTS]
    wrenches = [topic for topic, kind in kinds.items() if kind == WRENCH]
    for topic in topics:
        if topic not in kinds:
            raise LogError(f"{file}: no topic '{topic}'; {one_of(topic, [*joints, *wrenches])}")
        if topic not in joints and topic not in wrenches:
            raise LogError(
                f"{file}: topic '{topic}' holds {kinds[topic]}; valid: {JOINTS} and {WRENCH}"
            )
    if not joints:
        held = ", ".join(sorted({f"{t} ({kind})" for t, kind in kinds.items()})[:8])
        raise LogError(f"{file}: no topic of {JOINTS}; it holds: {held or 'no topic'}")
    wanted = [topic for topic in topics if topic in joints] or _with_messages(joints, connections)
    if len(wanted) > 1 and not set(topics) & set(joints):
        raise LogError(
            f"{file}: several topics hold joint states: {', '.join(sorted(wanted))}; name one, "
            f"{file}#{min(wanted)}, or several, to be merged, with commas between"
        )
    wanted += [topic for topic in topics if topic in wrenches]
    notes = [
        f"topic {topic} ({kinds[topic]}) is left out; to have it: #{','.join([*wanted, topic])}"
        for topic in wrenches
        if topic not in wanted
    ]
    return [each for each in connections if each.topic in wanted], notes


def _with_messages(topics: list[str], connections: Sequence[Any]) -> list[str]:
    """The topics with messages, or all if none has any."""
    filled = {each.topic for each in connections if each.msgcount}
    return [topic for topic in topics if topic in filled] or topics


def _decoded(reader: Any, connections: list[Any], file: str) -> Iterator[Message]:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    number: dict[str, int] = {}
    for count, (connection, received, raw) in enumerate(reader.messages(connections=connections)):
        if count >= LARGEST:
            raise LogError(f"{file}: more than {LARGEST} messages; cut the bag into several logs")
        kind = _kind(connection)
        message: Any = store.deserialize_cdr(raw, kind.replace("/", "/msg/"))
        time = message.header.stamp
        number[connection.topic] = number.get(connection.topic, 0) + 1
        try:
            columns, values = _content(message)
        except BadMessage as bad:
            place = f"topic {connection.topic}, message {number[connection.topic]}"
            raise LogError(f"{file}: {place}: {bad}") from None
        yield Message(connection.topic, received, time.sec * 10**9 + time.nanosec, columns, values)


def _content(message: Any) -> tuple[tuple[str, ...], Sequence[float]]:
    if hasattr(message, "position"):
        return joint_columns(message.name, message.position, message.velocity, message.effort)
    force, torque = message.wrench.force, message.wrench.torque
    values = [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    return wrench_columns(message.header.frame_id), values


def _kind(connection: Any) -> str:
    return str(connection.msgtype).replace("/msg/", "/")
