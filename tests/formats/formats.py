"""The four-bar of robots/, drawn closed, as a MuJoCo model and as an SDF."""

from __future__ import annotations

COUPLER, ROCKER = 0.609385308031, 1.218770616062  # [rad] where it is closed with the crank at 0

MJCF = f"""<mujoco model="four_bar">
  <compiler angle="radian"/>
  <option gravity="0 0 -9.81"/>
  <default><joint axis="0 -1 0" limited="false"/></default>
  <worldbody>
    <body name="crank_link">
      <joint name="crank"/>
      <inertial pos="0.0187 0.0096 0.0007" mass="0.7358"
        fullinertia="0.0001683 0.002125 0.002113 0.0001755 2.733e-05 2.851e-06"/>
      <geom type="box" size="0.095 0.005 0.015" pos="0.075 0 0"/>
      <body name="coupler_link" pos="0.15 -0.012 0" axisangle="0 -1 0 {COUPLER}">
        <joint name="coupler" ref="{COUPLER}"/>
        <inertial pos="0.2327 -0.0101 0.0202" mass="1.121"
          fullinertia="0.0007267 0.01581 0.0154 0.0003084 -0.0006168 0.0002243"/>
      </body>
    </body>
    <body name="rocker_link" pos="0.4 0 0" axisangle="0 -1 0 {ROCKER}">
      <joint name="rocker" ref="{ROCKER}" limited="true" range="0.1 3.0"/>
      <inertial pos="0.0724 0.0062 -0.0037" mass="0.708"
        fullinertia="0.0001521 0.005286 0.005223 0.0001776 0.0001256 1.542e-05"/>
    </body>
  </worldbody>
  <equality><connect name="pin" body1="coupler_link" body2="rocker_link" anchor="0.41 0.006 0"/></equality>
  <actuator><motor joint="crank"/></actuator>
</mujoco>
"""  # noqa: E501


def _link(name: str, pose: str, centre: str, mass: float, inertia: str) -> str:
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    tensor = "".join(
        f"<{key}>{value}</{key}>" for key, value in zip(keys, inertia.split(), strict=True)
    )
    return (
        f'<link name="{name}"><pose>{pose}</pose><inertial><pose>{centre} 0 0 0</pose>'
        f"<mass>{mass}</mass><inertia>{tensor}</inertia></inertial></link>"
    )


def _joint(name: str, parent: str, child: str, more: str = "") -> str:
    return (
        f'<joint name="{name}" type="revolute">{more}<parent>{parent}</parent>'
        f"<child>{child}</child>"
        '<axis><xyz expressed_in="__model__">0 -1 0</xyz></axis></joint>'
    )


SDF = f"""<?xml version="1.0"?>
<sdf version="1.9"><world name="lab"><gravity>0 0 -9.81</gravity>
<model name="ground_plane"><static>true</static><link name="plane"/></model>
<model name="four_bar">
{_link("crank_link", "0 0 0 0 0 0", "0.0187 0.0096 0.0007", 0.7358,
       "0.0001683 0.002125 0.002113 0.0001755 2.733e-05 2.851e-06")}
{_link("coupler_link", f"0.15 -0.012 0 0 {-COUPLER} 0", "0.2327 -0.0101 0.0202", 1.121,
       "0.0007267 0.01581 0.0154 0.0003084 -0.0006168 0.0002243")}
{_link("rocker_link", f"0.4 0 0 0 {-ROCKER} 0", "0.0724 0.0062 -0.0037", 0.708,
       "0.0001521 0.005286 0.005223 0.0001776 0.0001256 1.542e-05")}
{_joint("crank", "world", "crank_link")}
{_joint("coupler", "crank_link", "coupler_link")}
{_joint("rocker", "world", "rocker_link")}
{_joint("pin", "coupler_link", "rocker_link",
        '<pose relative_to="coupler_link">0.41 0.006 0 0 0 0</pose>')}
</model></world></sdf>
"""  # fmt: skip
