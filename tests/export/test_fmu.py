"""FMUs: valid without a message, and moving as ident's own integration does."""

import io
import zipfile

import numpy as np
import pytest
from compiled import compiler

import ident
from ident import Torques
from ident.export.export import export
from ident.log import Log

fmpy = pytest.importorskip("fmpy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["arm", "four_bar"])
def test_valid_and_moving_as_ident(name, fmi, robots, tmp_path):
    compiler()
    mechanism = ident.load(robots / name)
    for kind in ("viscous", "coulomb"):
        for joint in mechanism.driven:
            mechanism = mechanism.with_effect(f"{kind}:{joint}")
    values = {full: 0.05 for e in mechanism.effects for full in e.names}
    made = export(mechanism, "fmu", values=values, out=tmp_path / "machine.fmu", fmi=fmi)
    (path,) = made.write()
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        assert {"modelDescription.xml", "sources/machine.c", "sources/machine.h"} <= {
            *archive.namelist()
        }
    joints = [j for j in mechanism.driven]
    signals = np.array(
        [(0.0, *[0.3] * len(joints)), (1.0, *[0.3] * len(joints))],
        dtype=[("time", float), *((f"tau.{j}", float) for j in joints)],
    )
    result = fmpy.simulate_fmu(
        str(path), stop_time=0.5, output_interval=0.01, input=signals, fmi_type="CoSimulation",
        output=[f"q.{j}" for j in joints],
    )  # fmt: skip
    t = np.linspace(0, 0.5, 51)
    start = {j: mechanism.assembled[mechanism.joint(j).index] for j in joints}
    columns = {f"tau.{j}": np.full(51, 0.3) for j in joints}
    columns |= {f"q.{j}": np.full(51, x) for j, x in start.items()}
    run = ident.integrate(
        mechanism, Torques(Log.from_arrays("constant", t, columns)), values=values, rate=100.0
    )
    for j in joints:
        own = run.y[:, mechanism.joint_index[j]]
        found = np.interp(t, result["time"], result[f"q.{j}"])
        np.testing.assert_allclose(found, own, rtol=0, atol=1e-6)


def test_equal_machines_are_equal_files(robots, tmp_path):
    mechanism = ident.load(robots / "four_bar")
    one, two = (export(mechanism, "fmu", out=tmp_path / "x.fmu").files["x.fmu"] for _ in range(2))
    names = [zipfile.ZipFile(io.BytesIO(x)).namelist() for x in (one, two)]
    assert names[0] == names[1]


def test_an_fmi_that_is_not_there(robots):
    with pytest.raises(ident.IdentError, match="valid: 2, 3"):
        export(ident.load(robots / "four_bar"), "fmu", fmi=1)


def test_drives_are_outside(robots):
    mechanism = ident.load(robots / "servo_arm")
    values = {full: 0.05 for e in mechanism.effects for full in e.names}
    said = dict(export(mechanism, "fmu", values=values).fixed)
    assert said["servo:elbow"] == "its torque is the command here"
    assert (
        said["coulomb:elbow"] == dict(export(mechanism, "c", values=values).fixed)["coulomb:elbow"]
    )
