"""ROS 2 bags: written by rosbags in both storages and, as a second witness, by the mcap package."""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ident
from helpers import ROBOTS
from ident.errors import LogError
from ident.log import Column, read_log

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

STORE = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
JOINTS = "sensor_msgs/msg/JointState"
STORAGES = {"db3": rosbag2.StoragePlugin.SQLITE3, "mcap": rosbag2.StoragePlugin.MCAP}
BEGIN = 1_700_000_000_123_456_789  # [ns]


@dataclass(frozen=True)
class Say:
    """A message of a test: at `t` [ns] since BEGIN; `stamp` otherwise, where it is given."""

    t: int
    names: str = "a b"
    q: Iterable[float] = ()
    v: Iterable[float] = ()
    tau: Iterable[float] = ()
    topic: str = "/joint_states"
    stamp: int | None = None

    def message(self) -> Any:
        types = STORE.types
        stamp = BEGIN + self.t if self.stamp is None else self.stamp
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        header = types["std_msgs/msg/Header"](time, "")
        arrays = (np.array([*x], float) for x in (self.q, self.v, self.tau))
        return types[JOINTS](header, self.names.split(), *arrays)


def write(path: Path, said: Iterable[Say], storage: str = "mcap", others: Any = ()) -> Path:
    """A bag of these messages, received 5 ms after their stamps."""
    with rosbag2.Writer(path, version=9, storage_plugin=STORAGES[storage]) as writer:
        connections: dict[str, Any] = {}
        for topic, kind in others:
            connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
        for each in said:
            if each.topic not in connections:
                connections[each.topic] = writer.add_connection(each.topic, JOINTS, typestore=STORE)
            raw = STORE.serialize_cdr(each.message(), JOINTS)
            writer.write(connections[each.topic], BEGIN + each.t + 5_000_000, raw)
    return path


def plain(n: int = 40, **more: Any) -> list[Say]:
    return [
        Say(k * 10_000_000, q=(k, -k), v=(0.5, k), tau=(2.0 * k, np.nan), **more) for k in range(n)
    ]


@pytest.mark.parametrize("storage", STORAGES)
def test_what_was_said_is_read(tmp_path: Path, storage: str) -> None:
    bag = write(tmp_path / "run", plain(), storage)
    (file,) = bag.glob(f"*.{storage}")
    k = np.arange(40.0)
    for path in (bag, file):
        log = read_log(path)
        np.testing.assert_allclose(log.t, 0.01 * k, rtol=0, atol=1e-15)
        assert set(log.columns) == {"q.a", "q.b", "v.a", "v.b", "tau.a", "tau.b"}
        np.testing.assert_array_equal(log.columns["q.b"], -k)
        np.testing.assert_array_equal(log.columns["v.b"], k)
        np.testing.assert_array_equal(log.columns["tau.a"], 2 * k)
        assert log.name == path.name
        assert log.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()
        assert log.repairs == (
            "t counts from the first message, 1700000000.123456789 s of its clock",
            "column 'tau.b' is empty",
        )


def test_another_writer(tmp_path: Path) -> None:
    """The makers of MCAP write the same message by their own serialiser."""
    writer_of = pytest.importorskip("mcap_ros2.writer")
    definition = "\n".join(
        [
            "std_msgs/Header header", "string[] name", "float64[] position",
            "float64[] velocity", "float64[] effort", "=" * 80, "MSG: std_msgs/Header",
            "builtin_interfaces/Time stamp", "string frame_id", "=" * 80,
            "MSG: builtin_interfaces/Time", "int32 sec", "uint32 nanosec",
        ]
    )  # fmt: skip
    rng = np.random.default_rng(0)
    x = rng.normal(size=(50, 3))
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = writer_of.Writer(stream)
        schema = writer.register_msgdef(JOINTS, definition)
        for k, row in enumerate(x):
            ns = BEGIN + k * 4_000_000
            stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
            writer.write_message(
                "/arm/joint_states",
                schema,
                {
                    "header": {"stamp": stamp, "frame_id": ""},
                    "name": ["elbow", "Ellenbogen-ä", "c"],
                    "position": list(row),
                    "velocity": [],
                    "effort": list(-row),
                },
                log_time=ns,
            )
        writer.finish()
    log = read_log(tmp_path / "other.mcap")
    np.testing.assert_allclose(log.t, 0.004 * np.arange(50), atol=1e-12)
    names = ("elbow", "Ellenbogen-ä", "c")
    assert list(log.columns) == [f"{p}.{name}" for p in ("q", "tau") for name in names]
    np.testing.assert_array_equal(np.array([log.columns[f"q.{n}"] for n in names]).T, x)
    np.testing.assert_array_equal(np.array([log.columns[f"tau.{n}"] for n in names]).T, -x)


def test_several_nodes_on_one_topic(tmp_path: Path) -> None:
    """Each speaks of its own joints, at its own rate; where they share a stamp they share a row."""
    one = [Say(k * 10_000_000, "a b", q=(k, -k)) for k in range(40)]
    two = [Say(k * 20_000_000, "c", q=(k,), tau=(1,)) for k in range(20)]
    late = [Say(k * 20_000_000 + 3_000_000, "d", v=(k,)) for k in range(20)]
    said = sorted([*one, *two, *late], key=lambda s: s.t)
    log = read_log(write(tmp_path / "run", said))
    assert len(log.t) == 60
    for name, t, x in (("q.b", 0.01, -1.0), ("q.c", 0.02, 1.0)):
        at, values = log.series(name)
        np.testing.assert_allclose(at, t * np.arange(len(at)), atol=1e-12)
        np.testing.assert_array_equal(values, x * np.arange(len(at)))
    np.testing.assert_allclose(log.series("v.d")[0], 0.02 * np.arange(20) + 0.003, atol=1e-12)
    assert any("3 different sets" in said for said in log.repairs)


def test_order_of_names_may_change(tmp_path: Path) -> None:
    said = [
        Say(k * 10_000_000, "a b" if k % 2 else "b a", q=(k, -k) if k % 2 else (-k, k))
        for k in range(20)
    ]
    log = read_log(write(tmp_path / "run", said))
    np.testing.assert_array_equal(log.columns["q.a"], np.arange(20.0))
    np.testing.assert_array_equal(log.columns["q.b"], -np.arange(20.0))


def test_topics(tmp_path: Path) -> None:
    """Several are no guess: one is named, or those that are to be merged."""
    other = [Say(s.t, "c", q=(s.t,), topic="/gripper/states") for s in plain()]
    bag = write(tmp_path / "run", [*plain(topic="/arm/states"), *other])
    with pytest.raises(LogError, match=r"several topics .*/arm/states, /gripper/states; name one"):
        read_log(bag)
    log = read_log(f"{bag}#/arm/states")
    assert log.name == "run#/arm/states"
    assert set(read_log(bag, topic="/gripper/states").columns) == {"q.c"}
    both = read_log(f"{bag}#/arm/states, /gripper/states")
    assert {"q.a", "q.c"} < set(both.columns)
    assert np.isfinite(both.columns["q.a"]).all()
    assert np.isfinite(both.columns["q.c"]).all()
    for wrong, says in (
        ("/arm/state", "did you mean '/arm/states'"),
        ("", "name one, such as"),
        ("/arm/states,", "name one, such as"),
    ):
        with pytest.raises(LogError, match=says):
            read_log(bag, topic=wrong)
    with pytest.raises(LogError, match="give one of them"):
        read_log(f"{bag}#/arm/states", topic="/arm/states")
    with pytest.raises(LogError, match="no ROS 2 bag"):
        read_log(ROBOTS / "arm" / "run.csv", topic="/arm/states")


def test_topics_without_messages_do_not_count(tmp_path: Path) -> None:
    bag = write(tmp_path / "run", plain(), others=[("/unused", JOINTS)])
    assert len(read_log(bag).t) == 40


def test_the_same_joint_in_two_topics(tmp_path: Path) -> None:
    said = [*plain(topic="/one"), *plain(topic="/two")]
    with pytest.raises(LogError, match=r"/one and /two both hold 'q\.a'"):
        read_log(write(tmp_path / "run", said), topic="/one,/two")


def test_without_stamps_messages_were_received(tmp_path: Path) -> None:
    said = plain(stamp=0)
    log = read_log(write(tmp_path / "run", said))
    np.testing.assert_allclose(log.t, 0.01 * np.arange(40), atol=1e-15)
    assert "40 of 40 messages have no stamp" in log.repairs[0]
    assert "1700000000.128456789 s" in log.repairs[1]


def test_stamps_said_twice(tmp_path: Path) -> None:
    said = [*plain(20), Say(19 * 10_000_000, q=(99, 99)), *plain(30)[20:]]
    log = read_log(write(tmp_path / "run", said))
    assert len(log.t) == 30
    assert log.columns["q.a"][19] == 19
    assert any("1 messages repeat the stamp" in said for said in log.repairs)


def test_names_and_units_of_mechanism_toml(tmp_path: Path) -> None:
    log = read_log(write(tmp_path / "run", plain()), {"tau.elbow": Column("tau.a", 0.5)})
    np.testing.assert_array_equal(log.columns["tau.elbow"], np.arange(40.0))
    with pytest.raises(LogError, match=r"'tau\.x'.*valid: .*tau\.a"):
        read_log(tmp_path / "run", {"tau.elbow": Column("tau.x")})


def test_commands_take_a_bag(tmp_path: Path, spoken: Callable[..., tuple[int, str, str]]) -> None:
    """The arm's own log as a bag gives what its CSV gives."""
    log = read_log(ROBOTS / "arm" / "run.csv")
    names = [column[2:] for column in log.columns if column.startswith("q.")]
    said = [
        Say(
            round(1e9 * t), " ".join(names), q=[log.columns[f"q.{n}"][k] for n in names],
            tau=[log.columns[f"tau.{n}"][k] for n in names],
        )
        for k, t in enumerate(log.t)
    ]  # fmt: skip
    bag = write(tmp_path / "run", said)
    status, out, err = spoken("identify", ROBOTS / "arm", bag, "--verbose")
    assert status == 0
    assert "counts from the first message" in err
    _, again, _ = spoken("identify", ROBOTS / "arm", ROBOTS / "arm" / "run.csv", "--verbose")
    own, other = (
        [line for line in text.splitlines() if not line.startswith("  ident ")]
        for text in (out, again.replace("run.csv", "run"))
    )
    assert own == other
    status, _, err = spoken("check", ROBOTS / "arm", f"{bag}#/joints")
    assert (status, err.count("\n")) == (1, 1)
    assert "valid: /joint_states" in err


# --- what is no bag, or a bad one --------------------------------------------------------------


def broken(change: Callable[[Path], object], path: Path, storage: str = "mcap") -> Path:
    bag = write(path / "run", plain(), storage)
    change(bag)
    return bag


def cut(bag: Path) -> None:
    (file,) = (f for f in bag.iterdir() if f.suffix in (".mcap", ".db3"))
    file.write_bytes(
        file.read_bytes()[:-500] if file.suffix == ".mcap" else file.read_bytes()[:900]
    )


def scrambled(bag: Path) -> None:
    (file,) = (f for f in bag.iterdir() if f.suffix in (".mcap", ".db3"))
    file.write_bytes(np.random.default_rng(0).bytes(4000))


def no_messages_table(bag: Path) -> None:
    with sqlite3.connect(bag / "run.db3") as connection:
        connection.execute("DROP TABLE messages")


BROKEN: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "truncated mcap": ("mcap", cut, "mcap recover"),
    "truncated db3": ("db3", cut, "no ROS 2 bag, or a damaged one"),
    "other bytes mcap": ("mcap", scrambled, "magic"),
    "other bytes db3": ("db3", scrambled, "not a database"),
    "no table": ("db3", no_messages_table, "missing tables"),
    "no data file": ("mcap", lambda bag: next(bag.glob("*.mcap")).unlink(), "missing"),
    "empty metadata": ("mcap", lambda bag: (bag / "metadata.yaml").write_text(""), "damaged"),
    "metadata of all else": (
        "mcap", lambda bag: (bag / "metadata.yaml").write_text("a: [1, 2"), "YAML",
    ),
    "metadata of another type": (
        "mcap", lambda bag: (bag / "metadata.yaml").write_text("[1, 2]"), "damaged",
    ),
    "no metadata": ("mcap", lambda bag: (bag / "metadata.yaml").unlink(), "metadata.yaml"),
    "elsewhere": (
        "mcap", lambda bag: shutil.move(bag, bag.with_name("moved")), "in that folder",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("storage", "change", "says"), BROKEN.values(), ids=BROKEN)
def test_what_is_no_bag(
    storage: str, change: Callable[[Path], object], says: str, tmp_path: Path
) -> None:
    bag = broken(change, tmp_path, storage)
    with pytest.raises(LogError) as caught:
        read_log(bag)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(bag))
    assert says in message


BAD: dict[str, tuple[list[Say], str]] = {
    "positions": ([*plain(5), Say(10**9, q=(1,))], "message 6: 2 names and 1 positions"),
    "velocities": ([Say(0, q=(1, 2), v=(1, 2, 3))], "message 1: 2 names and 3 velocities"),
    "efforts without names": ([Say(0, "", tau=(1,))], "0 names and 1 efforts"),
    "doubled names": ([Say(0, "a a", q=(1, 2))], "each joint needs its own"),
    "backward": (
        [*plain(20), *(Say(s.t + 10**9, q=s.q, stamp=BEGIN + s.t) for s in plain(20))],
        "stamps of 'q.a' go backward: 1700000000.123456789 s after 1700000000.313456789 s",
    ),
    "nothing in it": ([Say(k, "a b") for k in range(20)], "no message of joint states"),
    "too few": (plain(5), "at least 10 are needed"),
    "infinite": ([*plain(20), Say(10**9, q=(np.inf, 0))], "'q.a', index 20: inf"),
    "slow": ([Say(k * 10**9, q=(1, 2)) for k in range(200)], "not in seconds"),
}


@pytest.mark.parametrize(("said", "says"), BAD.values(), ids=BAD)
def test_messages_that_make_no_log(said: list[Say], says: str, tmp_path: Path) -> None:
    with pytest.raises(LogError) as caught:
        read_log(write(tmp_path / "run", said))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_other_topics_are_no_joint_states(tmp_path: Path) -> None:
    bag = write(tmp_path / "run", plain(), others=[("/image", "sensor_msgs/msg/Image")])
    with pytest.raises(LogError, match=r"/image' holds sensor_msgs/Image; valid: sensor_msgs"):
        read_log(bag, topic="/image")


def test_ros_1(tmp_path: Path) -> None:
    (tmp_path / "run.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(LogError, match="rosbags-convert"):
        read_log(tmp_path / "run.bag")


def test_without_rosbags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write(tmp_path / "run", plain())
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(LogError, match=r'pip install "ident\[ros\]"'):
        read_log(bag)
    for name in ("none.mcap", "none.db3", "none.mcap#/joint_states"):
        with pytest.raises(LogError, match="no such file"):
            read_log(tmp_path / name)
    assert ident.read_log(ROBOTS / "arm" / "run.csv").t.size
