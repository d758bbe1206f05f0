"""Laws that no kind of the library is, the joints that have them, and the sets of cases.

A law is a formula over the signals of its joint: q, v, a, load, t, temperature, and q_<other>,
v_<other> of another joint. `k` is found from the size: a share of the joint's own rms torque.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

SETS = {
    "tune": 0,
    "score": 500,
    "clean": 1000,
    "named": 2000,
    "check": 3000,
}  # first number of the seeds
NOISE = (0.005, 0.02)  # of torques, as a share of their rms
ENCODER = 0.02  # noise of positions (share of their standard deviation) over that of torques
SHARE = (0.04, 0.15)  # of a law's torque in its joint's
CLEAN = {"arm3": 60, "five_bar": 25, "crank_rocker": 15}


@dataclass(frozen=True, eq=False)
class Law:
    """A formula with its constants, at a joint of a machine.

    Attributes:
        signals: on which it depends; also: further sets that are right, where the model's own
            columns make the difference (Coulomb friction makes the mean of (1 + c cos q) sign v).
        kind: of the library, for named effects.
    """

    name: str
    machine: str
    joint: str
    formula: str
    signals: frozenset[str]
    constants: Mapping[str, float] = field(default_factory=dict)
    also: tuple[frozenset[str], ...] = ()
    kind: str = ""


@dataclass(frozen=True, eq=False)
class Case:
    """One log.

    Attributes:
        law: None on a clean log; noise: share of torques; seed: of motion, friction, size, noise.
    """

    name: str
    law: Law | None
    machine: str
    noise: float
    seed: int


def law(name: str, place: str, formula: str, signals: str, also: str = "", kind: str = "",
        **constants: float) -> Law:  # fmt: skip
    """`place` is machine.joint; `signals` are separated by spaces, further sets by commas."""
    machine, joint = place.split(".")
    sets = tuple(frozenset(full(s, joint) for s in each.split())
                 for each in (signals, *filter(None, also.split(","))))  # fmt: skip
    return Law(name, machine, joint, formula, sets[0], constants, sets[1:], kind)


def full(signal: str, joint: str) -> str:
    """`q` of the law's own joint is `q.elbow`, `q_yaw` another's `q.yaw`; time has no joint."""
    letter, _, other = signal.partition("_")
    return letter if letter == "t" else f"{letter}.{other or joint}"


# the model's own columns make most of the laws on the even places, of which the noise is 0.5 %
TUNE = (
    law("gas_spring", "arm3.shoulder", "k*sin(q + b)/sqrt(1 + c*cos(q + b))", "q", b=2.9, c=0.9),
    law("cam_rectified", "arm3.yaw", "k*abs(sin(2*q))", "q"),
    law("friction_saturating", "arm3.yaw", "k*v/(abs(v) + c)", "v", c=0.4),
    law("cam_two_lobes", "arm3.elbow", "k*(sin(3*q + b) + c*sin(6*q))", "q", b=0.5, c=0.6),
    law("stribeck_lorentz", "arm3.elbow", "k*sign(v)/(1 + (v/b)**2)", "v", b=0.35),
    law("detent", "arm3.yaw", "k*(sin(8*q) + c*sin(16*q))", "q", c=0.3),
    law("friction_power", "arm3.shoulder", "k*sign(v)*abs(v)**c", "v", c=0.4),
    law("coulomb_of_position", "arm3.elbow", "k*(1 + c*sin(3*q))*sign(v)", "q v", c=0.8),
    law("eddy_current", "arm3.yaw", "k*v/(1 + (v/b)**2)", "v", b=0.5),
    law("one_sided_cubic", "arm3.elbow", "k*((abs(q - b) + q - b)/2)**3", "q", b=0.7),
    law("viscous_of_position", "arm3.shoulder", "k*(1 + c*q**2)*v", "q v", c=2.0),
    law("bump_stop", "arm3.yaw", "k*exp(b*q)", "q", b=4.0),
    law("worm_gear", "arm3.yaw", "k*(1 + c*sign(load*v))*sign(v)", "load v", "load", c=0.7),
    law("toggle", "arm3.yaw", "k*sin(q - b)/sqrt(c - cos(q - b))", "q", b=0.15, c=1.02),
    law("hertz_friction", "arm3.elbow", "k*sqrt(abs(load))*sign(v)", "load v"),
    law("cross_cam", "arm3.yaw", "k*sin(3*q_elbow)", "q_elbow"),
    law("magnet_rational", "arm3.elbow", "k/((q - b)**2 + c**2)", "q", b=0.6, c=0.25),
    law("spring_of_temperature", "arm3.yaw", "k*q*exp(-temperature/b)", "q temperature", b=12.0),
    law("spring_product", "arm3.elbow", "k*q*sin(2*q_shoulder)", "q q_shoulder"),
    law("running_in", "arm3.shoulder", "k*exp(-t/b)*sign(v)", "t v", b=5.0),
    law("gas_spring", "five_bar.left", "k*sin(q + b)/sqrt(1 + c*cos(q + b))", "q", b=0.6, c=0.9),
    law("detent", "five_bar.right", "k*(sin(12*q) + c*sin(24*q))", "q", c=0.4),
    law("friction_saturating", "five_bar.left", "k*v/(abs(v) + c)", "v", c=0.3),
    law("coulomb_of_position", "five_bar.right", "k*(1 + c*sin(3*q))*sign(v)", "q v", c=0.7),
    law("cam_rectified", "crank_rocker.crank", "k*abs(sin(2*q + b))", "q", b=0.4),
    law("eddy_current", "crank_rocker.crank", "k*v/(1 + (v/b)**2)", "v", b=0.8),
)  # fmt: skip
SCORE = (
    law("gas_spring", "arm3.elbow", "k*sin(q + b)/sqrt(1 + c*cos(q + b))", "q", b=1.7, c=0.93),
    law("spring_with_rest_length", "arm3.yaw",
        "k*sin(q + b)*(1 - c/sqrt(1.2 - cos(q + b)))", "q", b=0.3, c=0.8),
    law("cam_rectified", "arm3.elbow", "k*abs(sin(1.5*q + b))", "q", b=-1.2),
    law("cam_pulses", "arm3.yaw", "k*exp(c*cos(3*q + b))", "q", b=0.6, c=1.6),
    law("friction_tanh", "arm3.elbow", "k*tanh(v/b)", "v", b=0.5),
    law("detent", "arm3.elbow", "k*(sin(12*q) + c*cos(24*q))", "q", c=0.4),
    law("stribeck_lorentz", "arm3.shoulder", "k*sign(v)/(1 + (v/b)**2)", "v", b=0.2),
    law("magnet_pair", "arm3.yaw", "k*(q - b)/((q - b)**2 + c**2)**2", "q", b=-0.2, c=0.4),
    law("eddy_current", "arm3.elbow", "k*v/(1 + (v/b)**2)", "v", b=0.9),
    law("coulomb_of_position", "arm3.yaw", "k*sin(2*q + b)*sign(v)", "q v", b=0.8),
    law("viscous_of_position", "arm3.elbow", "k*exp(c*q)*v", "q v", c=1.2),
    law("friction_power", "arm3.yaw", "k*sign(v)*abs(v)**c", "v", c=3.0),
    law("bump_both_sides", "arm3.shoulder", "k*(exp(b*(q + c)) - exp(-b*(q + c)))", "q",
        b=5.0, c=0.5),
    law("one_sided_square", "arm3.yaw", "k*((abs(q - b) + q - b)/2)**2", "q", b=0.1),
    law("hertz_friction", "arm3.shoulder", "k*abs(load)**(2/3)*sign(v)", "load v"),
    law("spring_of_two_joints", "arm3.elbow", "k*sin(4*(q + q_shoulder))", "q q_shoulder"),
    law("stribeck_exponential", "arm3.elbow", "k*sign(v)*exp(-abs(v)/b)", "v", b=0.35),
    law("toggle", "arm3.elbow", "k*q/sqrt(c**2 - q**2)", "q", c=1.95),
    law("spring_relaxing", "arm3.shoulder", "k*exp(-t/b)*sin(4*q)", "q t", b=7.0),
    law("viscous_of_temperature", "arm3.yaw", "k*exp(-temperature/b)*v", "temperature v", b=8.0),
    law("magnet_rational", "five_bar.right", "k/((q - b)**2 + c**2)", "q", b=0.95, c=0.12),
    law("eddy_current", "five_bar.right", "k*v/(1 + (v/b)**2)", "v", b=0.6),
    law("spring_with_rest_length", "five_bar.left",
        "k*sin(q + b)*(1 - c/sqrt(1.03 - cos(q + b)))", "q", b=-2.1, c=0.8),
    law("viscous_of_position", "five_bar.left", "k*(1 + c*cos(2*q))*v", "q v", c=0.8),
    law("stribeck_lorentz", "crank_rocker.crank", "k*sign(v)/(1 + (v/b)**2)", "v", b=0.5),
    law("detent", "crank_rocker.crank", "k*(sin(6*q) + c*sin(12*q))", "q", c=0.3),
)  # fmt: skip
# written after the search was made, to see whether it holds on others than those it was made with
CHECK = (
    law("toggle_spring", "arm3.yaw", "k*(q - b)/sqrt((q - b)**2 + c**2)", "q", b=0.25, c=0.3),
    law("spring_with_rest_length", "arm3.shoulder",
        "k*sin(q + b)*(1 - c/sqrt(1.15 - cos(q + b)))", "q", b=0.4, c=0.7),
    law("tight_spot", "arm3.yaw", "k*exp(-((q - b)/c)**2)*sign(v)", "q v", b=-0.3, c=0.25),
    law("coulomb_with_a_step", "arm3.elbow", "k*(1 + c*tanh((q - b)/0.2))*sign(v)", "q v",
        b=0.6, c=0.7),
    law("load_viscous", "arm3.elbow", "k*abs(load)*v", "load v"),
    law("viscous_wave", "arm3.shoulder", "k*sin(5*q + b)*v", "q v", b=1.1),
    law("saturating_spring", "arm3.elbow", "k*tanh((q - b)/c)", "q", b=0.7, c=0.2),
    law("eyring", "arm3.yaw", "k*sign(v)*log(1 + abs(v)/c)", "v", c=0.05),
    law("hertz_stop", "arm3.elbow", "k*((abs(q - b) + q - b)/2)**1.5", "q", b=0.5),
    law("quadratic_spring", "arm3.yaw", "k*(q - b)*abs(q - b)", "q", b=-0.15),
    law("square_of_load", "arm3.shoulder", "k*load**2*sign(v)", "load v"),
    law("friction_grows", "arm3.elbow", "k*exp(c*q)*sign(v)", "q v", c=-1.5),
    law("warm_coulomb", "arm3.shoulder", "k*exp(-temperature/b)*sign(v)", "temperature v", b=10.0),
    law("shaft", "arm3.elbow", "k*sin(3*(q - q_shoulder) + b)", "q q_shoulder", b=0.9),
    law("dry_coupling", "arm3.yaw", "k*cos(4*q_elbow)*sign(v)", "v q_elbow"),
    law("stribeck_wide", "arm3.yaw", "k*sign(v)/(1 + (abs(v)/b)**1.5)", "v", b=0.3),
    law("vibration", "arm3.shoulder", "k*sin(b*t + c)", "t", b=23.0, c=0.5),
    law("magnet", "arm3.shoulder", "k*(q - b)*exp(-((q - b)/c)**2)", "q", b=0.2, c=0.2),
    law("saturating_spring", "five_bar.right", "k*tanh((q - b)/c)", "q", b=0.9, c=0.1),
    law("cam_rectified", "five_bar.left", "k*abs(sin(3*q + b))", "q", b=0.2),
    law("coulomb_of_position", "crank_rocker.crank", "k*(1 + c*cos(2*q + b))*sign(v)", "q v",
        ("q"), b=0.7, c=0.8),
    law("stribeck_exponential", "five_bar.right", "k*sign(v)*exp(-abs(v)/b)", "v", b=0.3),
    law("cam_pulses", "crank_rocker.crank", "k*exp(c*cos(q + b))", "q", b=0.5, c=2.5),
    law("friction_power", "five_bar.left", "k*sign(v)*abs(v)**c", "v", c=2.5),
    law("two_harmonics", "arm3.yaw", "k*(sin(2*q + b) + c*sin(4*q + b))", "q", b=0.5, c=0.5),
    law("v_spring", "arm3.elbow", "k*abs(q - b)", "q", b=0.7),
    law("dead_zone", "arm3.yaw", "k*(abs(q - b + c) - abs(q - b - c) - 2*(q - b))", "q",
        b=0.1, c=0.3),
    law("cubic_drag", "arm3.shoulder", "k*v**3", "v"),
    law("wedge", "arm3.yaw", "k*abs(q - b)*sign(v)", "q v", b=0.1),
    law("root_drag", "arm3.elbow", "k*sign(v)*sqrt(abs(v))", "v"),
    law("damper_of_position", "arm3.elbow", "k*q*v", "q v"),
    law("warm_grease", "arm3.yaw", "k*v*exp(-temperature/b)", "temperature v", b=9.0),
    law("shaft_sum", "arm3.elbow", "k*cos(4*(q_shoulder + q) + b)", "q q_shoulder", b=0.3),
    law("one_way_damper", "arm3.yaw", "k*(v + abs(v))/2", "v"),
    law("root_of_load", "arm3.shoulder", "k*sqrt(abs(load))*sign(v)", "load v"),
    law("settling", "arm3.elbow", "k*exp(-t/b)", "t", b=3.0),
    law("drag_of_position", "arm3.shoulder", "k*(1 + c*sin(2*q + b))*v*abs(v)", "q v",
        b=0.4, c=0.7),
    law("v_spring", "five_bar.left", "k*abs(q - b)", "q", b=2.1),
    law("wave_friction", "crank_rocker.crank", "k*sin(3*q + b)*sign(v)", "q v", ("q"), b=0.5),
    law("cubic_drag", "five_bar.right", "k*v**3", "v"),
    law("cam_cube", "crank_rocker.crank", "k*cos(q - b)**3", "q", b=0.8),
    law("damper_of_position", "five_bar.left", "k*(q - b)*v", "q v", b=1.0),
    law("dwell_cam", "crank_rocker.crank", "k*tanh(4*sin(q + b))", "q", b=0.3),
)  # fmt: skip
NAMED = (
    law("viscous", "arm3.yaw", "k*v", "v", kind="viscous"),
    law("viscous", "arm3.elbow", "k*v", "v", kind="viscous"),
    law("viscous", "five_bar.left", "k*v", "v", kind="viscous"),
    law("coulomb", "arm3.yaw", "k*sign(v)", "v", kind="coulomb"),
    law("coulomb", "arm3.shoulder", "k*sign(v)", "v", kind="coulomb"),
    law("coulomb", "five_bar.right", "k*sign(v)", "v", kind="coulomb"),
    law("stribeck", "arm3.yaw", "k*sign(v)*exp(-(v/b)**2)", "v", kind="stribeck", b=0.4),
    law("stribeck", "arm3.elbow", "k*sign(v)*exp(-(v/b)**2)", "v", kind="stribeck", b=0.5),
    law("stribeck", "five_bar.left", "k*sign(v)*exp(-(v/b)**2)", "v", kind="stribeck", b=0.3),
    law("load_friction", "arm3.shoulder", "k*abs(load)*sign(v)", "load v", kind="load_friction"),
    law("load_friction", "arm3.elbow", "k*abs(load)*sign(v)", "load v", kind="load_friction"),
    law("drag", "arm3.yaw", "k*v*abs(v)", "v", kind="drag"),
    law("drag", "arm3.elbow", "k*v*abs(v)", "v", kind="drag"),
    law("drag", "five_bar.right", "k*v*abs(v)", "v", kind="drag"),
    law("spring", "arm3.yaw", "k*(q - b)", "q", kind="spring", b=0.2),
    law("spring", "arm3.elbow", "k*(q - b)", "q", kind="spring", b=0.5),
    law("spring", "five_bar.left", "k*(q - b)", "q", kind="spring", b=2.0),
    law("cable", "arm3.yaw", "k*(q + c*q**3)", "q", kind="cable", c=4.0),
    law("cable", "arm3.elbow", "k*(q + c*q**3)", "q", kind="cable", c=1.0),
    law("end_stop", "arm3.yaw", "k*(abs(q - b) + q - b)/2", "q", kind="end_stop", b=0.7),
    law("end_stop", "arm3.elbow", "k*(abs(q - b) + q - b)/2", "q", kind="end_stop", b=1.3),
    law("rotor_inertia", "arm3.elbow", "k*a", "a", kind="rotor_inertia"),
    law("ripple", "arm3.yaw", "k*sin(6*q + b)", "q", kind="ripple", b=0.4),
    law("ripple", "arm3.shoulder", "k*sin(9*q + b)", "q", kind="ripple", b=1.4),
    law("ripple", "arm3.elbow", "k*sin(5*q + b)", "q", kind="ripple", b=2.4),
    law("ripple", "five_bar.right", "k*sin(10*q + b)", "q", kind="ripple", b=0.4),
    law("torque_offset", "arm3.yaw", "k", "", kind="torque_offset"),
    law("torque_offset", "arm3.elbow", "k", "", kind="torque_offset"),
    law("drift", "arm3.shoulder", "k*t", "t", kind="drift"),
    law("drift", "arm3.yaw", "k*t", "t", kind="drift"),
    law("temperature_friction", "arm3.yaw", "k*(temperature - 25)*v", "temperature v",
        kind="temperature_friction"),
)  # fmt: skip


def cases(of: str) -> list[Case]:
    """The cases of one of `SETS`; the two levels of noise in turns."""
    first = SETS[of]
    if of == "clean":
        found: Sequence[tuple[Law | None, str]] = [
            (None, machine) for machine, count in CLEAN.items() for _ in range(count)
        ]
    else:
        laws = {"tune": TUNE, "score": SCORE, "named": NAMED, "check": CHECK}[of]
        found = [(each, each.machine) for each in laws]
    result = []
    for k, (each, machine) in enumerate(found):
        what = f"{each.name}.{each.joint}" if each else str(k + 1)
        result.append(
            Case(f"{of}/{machine}/{what}", each, machine, NOISE[k % len(NOISE)], first + k)
        )
    return result
