"""A passive joint that turns as a driven one does: friction of either has the same columns."""

import numpy as np
import pytest

import ident
from ident import Log, Noise

LINK = (
    '<link name="{0}_link"><inertial><origin xyz="0 0 -{1}"/><mass value="{2}"/><inertia '
    'ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}_link"/>'
    '<origin xyz="{2} 0 0"/><axis xyz="0 1 0"/>'
    '<limit lower="-3" upper="3" effort="50" velocity="20"/></joint>'
)
MIRROR = (
    'urdf = "two.urdf"\n[joints]\npassive = ["mirror"]\n'
    '[[closure]]\nname = "gear"\nkind = "linear"\njoints = ["first", "mirror"]\nratios = [1, 1]\n'
)


@pytest.fixture(scope="module")
def mirrored(tmp_path_factory):
    """Two driven pendulums, one on the other, and a passive one that mirrors the first."""
    folder = tmp_path_factory.mktemp("mirror")
    chain = (("first", "base", 0.0), ("second", "first_link", 0.1), ("mirror", "base", 0.5))
    bodies = (LINK.format("first", 0.2, 1.0), LINK.format("second", 0.1, 0.5))
    parts = [*bodies, LINK.format("mirror", 0.1, 0.3), *(JOINT.format(*each) for each in chain)]
    text = f'<robot name="two"><link name="base"/>{"".join(parts)}</robot>'
    (folder / "two.urdf").write_text(text)
    (folder / "mechanism.toml").write_text(MIRROR)
    return ident.load(folder)


def diagnosed(mechanism, **values):
    """A diagnosis of the model without effects; `values` are those of the simulated ones."""
    t = np.arange(0, 10, 0.005)
    angle = np.outer(t, 2 * np.pi * np.array([0.31, 0.53, 0.87]))
    columns = {
        "q.first": np.sin(angle) @ [0.8, 0.3, 0.1],
        "q.second": np.sin(angle + 1) @ [0.3, -0.6, 0.2],
    }
    hidden, planted = mechanism, {}
    for name, pair in values.items():
        kind, parameter = name.split("_")
        for joint, value in zip(("first", "second"), pair, strict=True):
            hidden = hidden.with_effect(f"{kind}:{joint}")
            planted[f"{kind}.{joint}.{parameter}"] = value
    log, _ = ident.simulate(
        hidden, Log.from_arrays("run.csv", t, columns), values=planted,
        noise=[Noise("tau", 0.01, relative=True)], seed=1,
    )  # fmt: skip
    return ident.diagnose(ident.identify(mechanism, ident.complete(mechanism, log, cutoff="auto")))


def test_of_the_same_columns_those_of_a_drive_are_named_first(mirrored):
    found = diagnosed(mirrored, coulomb_Fc=(0.6, 0.4))
    assert found.best.label == "coulomb:first"
    assert [each.label for each in found.rivals] == ["coulomb:mirror"]
