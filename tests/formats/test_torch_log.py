"""Tensors of `.pt` files without torch, and lists in the cells of a Parquet file."""

import struct
import zipfile

import numpy as np
import polars as pl
import pytest

from helpers import ROBOTS
from ident.errors import LogError
from ident.log import Column, read_log

KINDS = {
    "<f8": b"DoubleStorage", "<f4": b"FloatStorage", "<i8": b"LongStorage",
    "<u2": b"BFloat16Storage",
}  # fmt: skip


def text(word):
    raw = word.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def number(n):
    return b"J" + struct.pack("<i", n)


def numbers(values):
    return b"(" + b"".join(map(number, values)) + b"t"


def tensor(key, x, size=None, stride=None, offset=0):
    """The pickle of a tensor as torch.save writes it."""
    stride = [s // x.itemsize for s in x.strides] if stride is None else stride
    kind = b"ctorch\n" + KINDS[x.dtype.str] + b"\n"
    storage = b"(" + text("storage") + kind + text(key) + text("cpu") + number(x.size) + b"tQ"
    hooks = b"ccollections\nOrderedDict\n)R"
    shape = numbers(x.shape if size is None else size)
    arguments = storage + number(offset) + shape + numbers(stride) + b"\x89" + hooks
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + arguments + b"tR"


def saved(path, arrays, more=b"", **changed):
    named = enumerate(arrays.items())
    items = b"".join(text(name) + tensor(str(i), x, **changed) for i, (name, x) in named)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("log/data.pkl", b"\x80\x02}(" + items + more + b"u.")
        for i, x in enumerate(arrays.values()):
            archive.writestr(f"log/data/{i}", x.tobytes())
    return path


def arrays(n=50):
    t = np.arange(n) / 100
    q = np.stack([np.sin(t), np.cos(t)], axis=1).astype("<f4")
    return {"time": t, "dof_pos": q, "step": np.arange(n)}


def test_tensors_become_columns(tmp_path):
    path = saved(tmp_path / "run.pt", arrays())
    columns = {"t": Column("time")}
    log = read_log(path, columns)
    assert [*log.columns] == ["dof_pos.0", "dof_pos.1", "step"]
    np.testing.assert_allclose(log.columns["dof_pos.1"], np.cos(log.t), atol=1e-6)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (text("x") + b"cos\nsystem\n(" + text("touch hacked") + b"tR", r"os\.system"),
        (text("x") + b"ctorch.nn.modules.linear\nLinear\n)R", r"torch\.nn\.modules\.linear"),
        (text("x") + b"cbuiltins\neval\n(" + text("1") + b"tR", r"builtins\.eval"),
    ],
)
def test_anything_but_tensors_is_refused_by_name(tmp_path, more, word):
    path = saved(tmp_path / "run.pt", arrays(), more)
    with pytest.raises(LogError, match=word):
        read_log(path)
    assert not (tmp_path / "hacked").exists()


@pytest.mark.parametrize(
    "changed",
    [{"size": (10**6,), "stride": (1,)}, {"size": (50,), "stride": (9,)},
     {"size": (40,), "stride": (1,), "offset": 30}, {"size": (10**9,), "stride": (0,)},
     {"size": (50,), "stride": (-1,), "offset": 49}],
)  # fmt: skip
def test_a_tensor_outside_its_storage_is_refused(tmp_path, changed):
    path = saved(tmp_path / "run.pt", {"time": np.arange(50) / 100}, **changed)
    with pytest.raises(LogError, match="damaged"):
        read_log(path)


def test_lists_in_each_other_many_times_over_are_walked_once(tmp_path):
    # l1 = [time], l2 = [l1] * 60, l3 = [l2] * 60 …: 60⁵ paths to tensors in a pickle of 1 kB
    body = b"]q\x01(" + tensor("0", arrays()["time"]) + b"e"
    for level in range(1, 6):
        body += b"0]q" + bytes([level + 1]) + b"(" + (b"h" + bytes([level])) * 60 + b"e"
    path = saved(tmp_path / "run.pt", arrays(), text("x") + body)
    assert "dof_pos.1" in read_log(path, {"t": Column("time")}).columns


def test_many_tensors_of_one_storage_take_its_memory_once(tmp_path, monkeypatch):
    # each key is read once, and columns beyond the limit are refused before they are made
    x = np.zeros((500, 100))
    more = b"".join(text(f"y{i}") + tensor("0", x) for i in range(60))
    path = saved(tmp_path / "run.pt", {"x": x}, more)
    monkeypatch.setenv("IDENT_LARGEST_LOG", "0.002")
    with pytest.raises(LogError, match=r"would take 0\.0244 GB"):
        read_log(path)


def test_bfloat16_is_the_upper_half_of_float32(tmp_path):
    full = np.linspace(-3.0, 3.0, 50).astype("<f4")
    half = (full.view("<u4") >> 16).astype("<u2")
    path = saved(tmp_path / "run.pt", {"time": np.arange(50) / 100, "dof_pos": half})
    read = read_log(path, {"t": Column("time")})
    np.testing.assert_allclose(read.columns["dof_pos"], full, rtol=2**-7)


def test_a_kind_of_number_that_is_not_read_is_called_that(tmp_path):
    more = text("x") + b"ctorch\nComplexFloatStorage\n"
    with pytest.raises(LogError, match=r"ComplexFloatStorage, a kind of number .*x\.float"):
        read_log(saved(tmp_path / "run.pt", arrays(), more))


def test_an_old_pickle_is_not_run(tmp_path):
    (tmp_path / "run.pt").write_bytes(b"cos\nsystem\n(" + text("touch hacked") + b"tR.")
    with pytest.raises(LogError, match="no ZIP"):
        read_log(tmp_path / "run.pt")


def test_lists_in_the_cells_of_a_parquet_file(tmp_path):
    # as LeRobot's data sets have actions and states
    log = pl.read_csv(ROBOTS / "servo_arm" / "run.csv").head(400)
    joints = ("yaw", "shoulder", "elbow")
    frame = log.select(
        timestamp=pl.col("t"),
        action=pl.concat_list(f"ref.{j}" for j in joints),
        state=pl.concat_list(f"q.{j}" for j in joints),
    ).rename({"state": "observation.state"})
    frame.write_parquet(tmp_path / "episode.parquet")
    read = read_log(tmp_path / "episode.parquet", {"t": Column("timestamp")})
    assert read.columns["observation.state.2"] == pytest.approx(log["q.elbow"].to_numpy())
    assert read.columns["action.0"] == pytest.approx(log["ref.yaw"].to_numpy())
