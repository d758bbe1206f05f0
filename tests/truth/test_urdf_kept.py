"""identified.urdf is the user's own document: outside of <inertial> nothing that it says changes.

What a document says is its canonical form (C14N), by Python's own XML library.
"""

from __future__ import annotations

import codecs
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ident
from ident.fit.files import identified_urdf
from ident.mechanism.parameters import regressor
from identification import plant

ODD = """<?xml version='1.0' encoding="utf-8" standalone="yes"?>
<!-- mit Liebe exportiert: <inertial><mass value="7"/></inertial> & Grüße -->
<?xml-stylesheet href="a.css"?>
<robot   name='odd'
   xmlns:xacro="http://www.ros.org/wiki/xacro">
\t<material name="grün"><color rgba="0 1 0 1" /></material>
  <link name="base"><visual><geometry><box size="1 1 1"/></geometry></visual></link>
  <link   xacro:kept='yes' name = "upper" >
    <visual><geometry><mesh scale="1 1 1" filename="package://odd/up&amp;per.stl"/></geometry></visual>
    <inertial>   <!-- from CAD -->
      <mass   value='1.50' />
      <origin rpy="0.1 0 0"   xyz="0.10 0 0.05"/>
      <inertia iyy="0.02" ixx="1e-2" ixy="0" ixz="0" iyz="0"
               izz="0.0200"/>
    </inertial>
    <xacro:property name="x" value="${pi}"/>
  </link>
  <joint type="revolute" name="shoulder">
    <child link="upper"/><parent link="base"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="3"/><dynamics damping="0.1"/>
  </joint>
  <link name="fore"/>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0.3 0 0" rpy="0 0 0.2"/><axis xyz="1 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="3"/></joint>
  <link name="plate"><inertial><mass value="0.3"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="glue" type="fixed"><parent link="upper"/><child link="plate"/></joint>
  <transmission name="t1"><type>transmission_interface/SimpleTransmission</type>
    <actuator name="m1"><mechanicalReduction>50</mechanicalReduction></actuator></transmission>
  <gazebo reference="upper"><!-- kept --><mu1>0.2</mu1><text><![CDATA[ a < b <inertial> ]]></text></gazebo>
</robot>


"""  # noqa: E501
FORE = """<link name="fore"><inertial><mass value="1"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
FULL = ODD.replace('<link name="fore"/>', FORE)


def declared(text: str, encoding: str) -> str:
    return text.replace("utf-8", encoding)


def bare(text: str) -> str:
    return text.partition("?>\n")[2]


WAYS = {  # of writing the same document
    "as it is": str.encode,
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "byte order mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "Latin-1": lambda text: declared(text, "iso-8859-1").encode("latin-1"),
    "Windows": lambda text: declared(text, "windows-1252").encode("cp1252"),
    "UTF-16": lambda text: declared(text, "utf-16").encode("utf-16"),
    "UTF-16 BE": lambda text: codecs.BOM_UTF16_BE + declared(text, "utf-16").encode("utf-16-be"),
    "no declaration": lambda text: bare(text).encode(),
    "tabs": lambda text: text.replace("  ", "\t").encode(),
    "one line": lambda text: text.replace("\n", " ").encode(),
    "no end of line": lambda text: text.strip().encode(),
    "single quotes": lambda text: bare(text).replace('"', "'").encode(),
}
URDFDOM = ("as it is", "CRLF", "no declaration", "tabs", "one line", "no end of line")


def fitted(data: bytes, folder: Path, given: Path | None = None) -> ident.Fit:
    """The URDF's own mechanism, fitted to a log in which its bodies are others."""
    (folder / "odd.urdf").write_bytes(data)
    mechanism = ident.load(given or folder / "odd.urdf")
    t = np.arange(500) / 100
    columns = {}
    for k, name in enumerate(("elbow", "shoulder")):
        columns[f"q.{name}"] = np.sin((2 + k) * t + k) + 0.3 * np.sin(5 * t)
        columns[f"v.{name}"] = (2 + k) * np.cos((2 + k) * t + k) + 1.5 * np.cos(5 * t)
        columns[f"a.{name}"] = -((2 + k) ** 2) * np.sin((2 + k) * t + k) - 7.5 * np.sin(5 * t)
    return plant(mechanism, ident.Log.from_arrays("run.csv", t, columns)).fit()


def canonical(data: bytes) -> str:
    """What a document says, comments included, without every link's <inertial> and indentation."""
    robot = ET.fromstring(data, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    for link in robot.iter("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    return ET.canonicalize(ET.tostring(robot), with_comments=True, strip_text=True)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("text", [FULL, ODD])
def test_nothing_else_changes(way, text, tmp_path):
    data = WAYS[way](text)
    new = fitted(data, tmp_path).write_urdf(tmp_path / "new.urdf").read_bytes()
    assert new != data
    assert canonical(new) == canonical(data)
    assert (b"\r\n" in new) == (b"\r\n" in data)


@pytest.mark.parametrize("way", WAYS)
def test_what_is_identified_is_read_back(way, tmp_path):
    """By Pinocchio, exactly."""
    plain = FULL.replace('<?xml-stylesheet href="a.css"?>\n', "")  # at which urdfdom stumbles
    fit = fitted(WAYS[way](plain), tmp_path)
    path = tmp_path / "new.urdf"
    path.write_bytes(identified_urdf(fit, possible=False))
    truth = fit.dynamic_parameters
    np.testing.assert_allclose(ident.load(path).prior, truth, atol=1e-13)
    if way in URDFDOM:  # it reads no other encoding
        model = pin.buildModelFromUrdf(str(path))
        found = np.concatenate([body.toDynamicParameters() for body in list(model.inertias)[1:]])
        np.testing.assert_allclose(found, truth, atol=1e-13)


def test_an_inertial_is_added(tmp_path):
    """To the link that has none; the mass is 1 kg there, shifted along what no torque feels."""
    fit = fitted(ODD.encode(), tmp_path)
    path = tmp_path / "new.urdf"
    path.write_bytes(identified_urdf(fit, possible=False))
    q, v, a = np.random.default_rng(0).normal(size=(3, 20, 2))
    torque = regressor(fit.mechanism.model, q, v, a) @ fit.dynamic_parameters
    again = ident.load(path).model
    found = [pin.rnea(again, again.createData(), *state) for state in zip(q, v, a, strict=True)]
    np.testing.assert_allclose(found, torque, atol=1e-11 * np.abs(torque).max())
    assert path.read_text().count("<!-- from CAD -->") == 1


def test_numbers_that_are_known_keep_their_text(tmp_path):
    """Of one body `Lyy` is asked for: the file's other numbers are not rewritten."""
    (tmp_path / "mechanism.toml").write_text(
        'urdf = "odd.urdf"\n[parameters]\nunknown = ["fore.Lyy"]\n'
    )
    (tmp_path / "odd.urdf").write_text(FULL)
    fit = fitted(FULL.encode(), tmp_path, tmp_path)
    new = identified_urdf(fit, possible=False).decode()
    pattern = r'<inertia ixx="1" iyy="([^"]+)" izz="1" ixy="0" ixz="0" iyz="0"/>'
    (value,) = re.findall(pattern, new)
    assert abs(float(value) - 1) > 0.01
    for kept in ('<mass value="1"/>', '<mass value="1.50"/>', 'ixx="1e-2"', 'rpy="0.1 0 0"'):
        assert kept in new
