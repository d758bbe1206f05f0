"""Tensors of `.pt` files without torch, and lists in the cells of a Parquet file."""

import struct
import zipfile

import numpy as np
import polars as pl
import pytest

from helpers import ROBOTS
from ident.errors import LogError
from ident.log import Column, read_log

KINDS = {"<f8": b"DoubleStorage", "<f4": b"FloatStorage", "<i8": b"LongStorage"}


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
