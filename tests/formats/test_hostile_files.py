"""Files that claim too much, never end or may not be replaced: one line, at once."""

import io
import os
import struct
import time
import warnings
import zipfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import ident
from helpers import ROBOTS
from ident.errors import IdentError, LogError, MechanismError
from ident.files import LARGEST_LOG, atomic_write, write_all
from ident.log.pieces import open_log
from ident.log.read import likely_rows

ARM = ROBOTS / "arm"
HEAVY = 5.0  # s
NEVER = "which may never end"
pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")


def test_what_a_killed_write_left_is_removed_by_the_next(tmp_path):
    dead, alive = (tmp_path / f".fit.json.{tag}.part" for tag in ("0123abcd", "89abcdef"))
    other = tmp_path / ".notes.0123abcd.part"
    for path in (dead, alive, other):
        path.write_text("half")
    os.utime(dead, (0.0, 0.0))
    os.utime(other, (0.0, 0.0))
    write_all(tmp_path, {"fit.json": b"{}"})
    assert sorted(x.name for x in tmp_path.iterdir()) == sorted(
        [alive.name, other.name, "fit.json"]
    )


@contextmanager
def refused(error, words):
    start = time.monotonic()
    with pytest.raises(error, match=words) as caught:
        yield
    assert time.monotonic() - start < HEAVY
    assert len(str(caught.value).splitlines()) == 1


def endless(path: Path, kind: str) -> Path:
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.symlink_to(path.name)  # itself
    return path


ENDLESS = pytest.mark.parametrize(
    ("kind", "words"), [("pipe", NEVER), ("device", NEVER), ("link", "symbolic links")]
)


@ENDLESS
@pytest.mark.parametrize("name", ["run.csv", "run.npz", "run.parquet"])
@pytest.mark.parametrize("read", [ident.read_log, open_log])
def test_a_log_that_never_ends(kind, words, name, read, tmp_path):
    path = endless(tmp_path / name, kind)
    with refused(LogError, words):
        read(path)
    assert likely_rows(path) == 0


@ENDLESS
@pytest.mark.parametrize("name", ["robot.urdf", "robot.xml"])
def test_a_mechanism_that_never_ends(kind, words, name, tmp_path):
    if kind != "link":
        with refused(MechanismError, words):
            ident.load(endless(tmp_path / name, kind))


@ENDLESS
def test_a_fit_that_never_ends(kind, words, tmp_path):
    with refused(IdentError, words):
        ident.read_fit(endless(tmp_path / "fit.json", kind), ident.load(ARM))


def test_a_link_to_itself_among_the_inputs_of_a_command(tmp_path, spoken):
    status, _, errors = spoken("identify", ARM, endless(tmp_path / "run.csv", "link"))
    assert status == 1
    assert "symbolic links" in errors
    assert "fault of ident" not in errors


def array_file(shape: tuple[int, ...], data: bytes) -> bytes:
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    return stream.getvalue() + data


def test_an_array_that_claims_more_than_its_file_holds(tmp_path):
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        archive.writestr("t.npy", array_file((10**12,), bytes(80)))
    with refused(LogError, "damaged"):
        ident.read_log(tmp_path / "run.npz")


def npy(x) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, np.asarray(x))
    return stream.getvalue()


def test_an_archive_of_very_many_arrays(tmp_path):
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive:
        for i in range(20_000):
            archive.writestr(f"a{i}.npy", npy(np.zeros(3)))
    with refused(LogError, "20,000 arrays"):
        ident.read_log(tmp_path / "run.npz")


def test_two_arrays_of_one_name(tmp_path):
    columns = (("t", np.arange(30.0)), ("q.yaw", np.zeros(30)), ("q.yaw", np.ones(30)))
    with zipfile.ZipFile(tmp_path / "run.npz", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # zipfile says it to the writer
        for name, x in columns:
            archive.writestr(f"{name}.npy", npy(x))
    with refused(LogError, "two arrays are named 'q.yaw'"):
        ident.read_log(tmp_path / "run.npz")


def test_an_element_of_very_many_attributes(tmp_path):
    attributes = " ".join(f'x{i}="1"' for i in range(200_000))
    text = (ARM / "arm.urdf").read_text().replace("<link ", f"<link {attributes} ", 1)
    (tmp_path / "arm.urdf").write_text(text)
    with refused(MechanismError, r"arm.urdf:\d+: <link> has 200,00\d attributes"):
        ident.load(tmp_path / "arm.urdf")


def record(operation: int, content: bytes) -> bytes:
    return bytes([operation]) + struct.pack("<Q", len(content)) + content


def text_of(word: str) -> bytes:
    return struct.pack("<I", len(word)) + word.encode()


def mcap(compression: str, data: bytes, claim: int) -> bytes:
    """An MCAP file with one topic of joint states and one chunk."""
    chunk = struct.pack("<QQQI", 0, 1, claim, 0) + text_of(compression)
    schema = text_of("sensor_msgs/msg/JointState") + text_of("ros2msg") + text_of("")
    channel = text_of("/joint_states") + text_of("cdr") + text_of("")
    records = [
        record(0x01, text_of("ros2") + text_of("")),
        record(0x03, struct.pack("<H", 1) + schema),
        record(0x04, struct.pack("<HH", 1, 1) + channel),
        record(0x06, chunk + struct.pack("<Q", len(data)) + data),
        record(0x0F, struct.pack("<I", 0)),
        record(0x02, struct.pack("<QQI", 0, 0, 0)),
    ]
    return b"\x89MCAP0\r\n" + b"".join(records) + b"\x89MCAP0\r\n"


@pytest.mark.parametrize("claim", [100, 300_000_000])
def test_a_chunk_of_a_bag_that_unpacks_to_very_much(claim, tmp_path):
    rosbag = pytest.importorskip("rosbags.rosbag2.storage_mcap")
    packed = rosbag.zstd.compress(bytes(300_000_000))
    assert len(packed) < 100_000
    path = tmp_path / "run.mcap"
    path.write_bytes(mcap("zstd", packed, claim))
    with refused(LogError, "unpacks to more than 256 MB"):
        ident.read_log(path)


@pytest.mark.parametrize("suffix", [".npz", ".parquet", ".csv"])
def test_what_would_take_too_much_memory(suffix, tmp_path, monkeypatch):
    t = np.arange(0.0, 20.0, 0.001)
    path = tmp_path / f"run{suffix}"
    if suffix == ".npz":
        np.savez_compressed(path, t=t, q=np.zeros_like(t))
    else:
        frame = pl.DataFrame({"t": t, "q": np.zeros_like(t)})
        (frame.write_csv if suffix == ".csv" else frame.write_parquet)(path)
    monkeypatch.setenv(LARGEST_LOG, "1e-4")
    with refused(LogError, r"at most 0\.0001 GB are taken.*--largest-log GB"):
        ident.read_log(path)
    monkeypatch.setenv(LARGEST_LOG, "1")
    assert len(ident.read_log(path).t) == len(t)
    monkeypatch.setenv(LARGEST_LOG, "much")
    with refused(IdentError, "valid: a size in GB"):
        ident.read_log(path)


def test_an_option_raises_the_limit(spoken, monkeypatch):
    monkeypatch.setenv(LARGEST_LOG, "1e-4")
    assert spoken("check", ARM, ARM / "run.csv")[0] == 1
    assert spoken("--largest-log", "1", "check", ARM, ARM / "run.csv")[0] == 0


def chain(links: int, kind: str) -> str:
    bodies = "".join(f'<link name="l{i}"/>' for i in range(links))
    joints = "".join(
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(links - 1)
    )
    return f'<robot name="r">{bodies}{joints}</robot>'


DEEP = {
    "elements.urdf": '<robot name="r">' + '<link name="a">' * 1000 + "</link>" * 1000 + "</robot>",
    "chain.urdf": chain(1001, "continuous"),
    "fixed.urdf": chain(1001, "fixed"),
    "bodies.xml": "<mujoco><worldbody>" + "<body><joint/>" * 1000 + "</body>" * 1000
    + "</worldbody></mujoco>",
}  # fmt: skip


@pytest.mark.parametrize("name", DEEP)
def test_a_thousand_nested_links(name, tmp_path):
    (tmp_path / name).write_text(DEEP[name])
    with refused(MechanismError, name):
        ident.load(tmp_path / name)


def write_one(path: Path) -> None:
    with atomic_write(path) as stream:
        stream.write(b"after")


WRITERS = {
    "one": write_one,
    "all": lambda path: write_all(path.parent, {"other": b"x", path.name: b"after"}),
    "log": lambda path: ident.Log.from_arrays("x", np.arange(20) / 10, {"q": np.zeros(20)}).write(
        path
    ),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_read_only_file_is_not_replaced(kind, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("before")
    path.chmod(0o444)  # which root, too, means
    with pytest.raises((OSError, IdentError), match="read-only"):
        WRITERS[kind](path)
    assert path.read_text() == "before"
    assert [each.name for each in tmp_path.iterdir()] == ["run.csv"]
