"""The cases, by category, once with seeds for choosing thresholds and once with seeds for scores.

The two sets hold the same effects on the same joints, but their motions, priors, sizes, shapes and
noise are drawn apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

SETS = {"tuning": 0, "scoring": 1000}  # first number of the seeds
MOTIONS = 4  # different motions of a mechanism a set
ARMS = ("arm3", "arm6")
FULL_MOTION = (
    "crank_rocker",
    "five_bar",
    "slider_crank",
)  # loops where leverage tells joints apart


@dataclass(frozen=True)
class Hidden:
    kind: str
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.kind}:{','.join(self.joints)}"


@dataclass(frozen=True)
class Case:
    """One log set.

    Attributes:
        size: multiplies the hidden effects; noise, encoder: levels of torques and positions.
        motion: seed of the references and of the effects' values; seed: of prior and noise.
        coloured: the torques' noise is correlated and the stamps jitter.
    """

    name: str
    category: str
    mechanism: str
    hidden: tuple[Hidden, ...]
    size: float
    noise: float
    encoder: float
    motion: int
    seed: int
    coloured: bool = False


def effects(*texts: str) -> list[tuple[Hidden, ...]]:
    """One entry a text; two effects are joined by " + "."""
    found = []
    for text in texts:
        parts = [part.partition(":") for part in text.split(" + ")]
        found.append(
            tuple(Hidden(kind, tuple(joints.split(",")) if joints else ())
                  for kind, _, joints in parts)
        )  # fmt: skip
    return found


VISIBLE = {
    "arm3": effects(
        "coulomb:yaw", "viscous:shoulder", "stribeck:elbow", "load_friction:shoulder",
        "hysteresis:yaw", "drag:yaw", "spring:elbow", "cable:yaw", "end_stop:elbow",
        "rotor_inertia:elbow", "ripple:shoulder", "torque_offset:elbow", "torque_gain:elbow",
        "delay:yaw", "encoder_offset:shoulder", "gravity_tilt", "drift:shoulder",
        "elasticity:shoulder", "temperature_friction:yaw", "stribeck:yaw", "spring:yaw",
        "coulomb:elbow", "ripple:elbow",
    ),
    "arm6": effects(
        "coupling:joint_5,joint_6", "coupling:joint_4,joint_5", "coulomb:joint_4",
        "viscous:joint_6", "stribeck:joint_3", "load_friction:joint_3", "hysteresis:joint_2",
        "drag:joint_4", "spring:joint_2", "cable:joint_6", "end_stop:joint_3",
        "rotor_inertia:joint_4", "rotor_inertia:joint_6", "ripple:joint_5",
        "torque_offset:joint_2", "torque_gain:joint_3", "delay:joint_1",
        "encoder_offset:joint_3", "gravity_tilt", "drift:joint_1", "end_stop:joint_1",
        "temperature_friction:joint_2", "stribeck:joint_1",
    ),
}  # fmt: skip
LOOP = {
    "crank_rocker": effects(
        "coulomb:crank", "coulomb:coupler", "coulomb:rocker", "coulomb:closure.pin",
        "viscous:crank", "viscous:rocker", "viscous:closure.pin", "stribeck:rocker",
        "drag:coupler", "hysteresis:crank",
        "end_stop:rocker", "ripple:crank", "drift:crank", "delay:crank", "torque_offset:crank",
    ),
    "crank_rocker_15": effects(
        "coulomb:rocker", "coulomb:closure.pin", "viscous:coupler", "viscous:crank",
        "drift:crank",
    ),
    "five_bar": effects(
        "coulomb:left", "coulomb:left_elbow", "coulomb:closure.tip", "viscous:right",
        "viscous:right_elbow", "stribeck:left", "spring:left_elbow", "cable:right",
        "torque_gain:left", "delay:right", "ripple:left", "drift:right", "drag:closure.tip",
        "torque_offset:right",
    ),
    "slider_crank": effects(
        "coulomb:theta", "coulomb:s", "viscous:s", "viscous:beta", "coulomb:alpha", "spring:s",
        "drag:theta", "ripple:theta", "drift:theta",
    ),
}  # fmt: skip
OUTSIDE = {
    "arm3": effects(
        "friction_decay:shoulder", "position_friction:yaw", "cross_spring:elbow,shoulder",
        "slosh:elbow", "disturbance:yaw", "bump:elbow", "late_friction:shoulder",
        "saturation:shoulder", "position_friction:elbow",
    ),
    "arm6": effects(
        "friction_decay:joint_1", "position_friction:joint_4", "cross_spring:joint_4,joint_6",
        "slosh:joint_3", "disturbance:joint_2", "bump:joint_6", "late_friction:joint_5",
        "saturation:joint_2",
    ),
    "crank_rocker": effects("slosh:crank", "disturbance:crank", "friction_decay:rocker"),
    "five_bar": effects("position_friction:left", "disturbance:right", "late_friction:left"),
    "slider_crank": effects("disturbance:theta"),
}  # fmt: skip
PARALLELOGRAM = {
    "parallelogram": effects(
        *(f"{kind}:{joint}" for kind in ("coulomb", "viscous")
          for joint in ("crank", "coupler", "rocker", "closure.pin"))
    )
}  # fmt: skip
QUARTER = {
    "arm3": effects(
        "coulomb:yaw", "viscous:elbow", "stribeck:elbow", "spring:yaw", "ripple:elbow",
        "drag:yaw", "end_stop:elbow", "rotor_inertia:elbow", "delay:yaw", "torque_offset:elbow",
    ),
    "arm6": effects(
        "coupling:joint_5,joint_6", "coulomb:joint_2", "viscous:joint_4", "spring:joint_6",
        "load_friction:joint_3", "encoder_offset:joint_3",
    ),
    "crank_rocker": effects("coulomb:rocker", "viscous:rocker"),
    "five_bar": effects("coulomb:left_elbow", "viscous:right"),
}  # fmt: skip
TWO = {
    "arm3": effects(
        "coulomb:yaw + spring:elbow", "viscous:shoulder + ripple:elbow",
        "end_stop:elbow + drag:yaw", "torque_offset:elbow + stribeck:yaw",
        "coulomb:elbow + viscous:elbow", "spring:elbow + ripple:elbow",
        "rotor_inertia:elbow + drift:shoulder", "delay:yaw + spring:shoulder",
    ),
    "arm6": effects(
        "coupling:joint_5,joint_6 + coulomb:joint_2", "spring:joint_4 + viscous:joint_1",
        "coulomb:joint_3 + ripple:joint_3", "end_stop:joint_1 + torque_offset:joint_4",
        "load_friction:joint_2 + spring:joint_6",
    ),
    "crank_rocker": effects("coulomb:rocker + ripple:crank"),
    "five_bar": effects("coulomb:left_elbow + viscous:right", "spring:left + coulomb:right"),
}  # fmt: skip
INVISIBLE = {
    "arm3": effects(
        "rotor_inertia:yaw", "encoder_offset:yaw", "rotor_inertia:shoulder", "payload:fore",
        "encoder_offset:elbow",
    ),
    "arm6": effects("rotor_inertia:joint_1", "encoder_offset:joint_1", "payload:link_6"),
    # a spring of a one-degree-of-freedom loop is one more potential beside gravity's
    "crank_rocker": effects(
        "torque_gain:crank", "rotor_inertia:crank", "spring:rocker", "spring:closure.pin",
    ),
    "crank_rocker_15": effects("spring:rocker"),
    "slider_crank": effects("torque_gain:theta"),
    "parallelogram": effects("torque_gain:crank"),
}  # fmt: skip
NOTHING: list[tuple[Hidden, ...]] = [()]
CLEAN = {
    "arm3": 6 * NOTHING, "arm6": 6 * NOTHING, "crank_rocker": 4 * NOTHING,
    "crank_rocker_15": 2 * NOTHING, "five_bar": 4 * NOTHING, "slider_crank": 3 * NOTHING,
}  # fmt: skip
CATEGORIES = {
    "visible": VISIBLE, "loop": LOOP, "clean": CLEAN, "outside": OUTSIDE,
    "parallelogram": PARALLELOGRAM, "quarter": QUARTER, "two": TWO, "invisible": INVISIBLE,
}  # fmt: skip
CI = (
    "visible/arm3/coulomb:yaw", "visible/arm3/spring:elbow", "visible/arm3/ripple:shoulder",
    "visible/arm6/coupling:joint_5,joint_6", "loop/crank_rocker/coulomb:rocker",
    "loop/five_bar/viscous:right", "clean/arm3/1", "clean/crank_rocker/1",
    "outside/arm3/disturbance:yaw", "parallelogram/parallelogram/coulomb:rocker",
    "two/arm3/coulomb:yaw + spring:elbow", "invisible/arm3/rotor_inertia:yaw",
)  # fmt: skip


def cases(of: str, encoder: float | None = None, seed: int | None = None) -> list[Case]:
    """The cases of a set, `tuning`, `scoring` or `ci`.

    Args:
        of: the set.
        encoder: level of the noise on positions; default: as that on torques.
        seed: first number of the seeds; default: those of the set.
    """
    if of == "ci":
        return [case for case in cases("tuning", encoder) if case.name.split("/", 1)[1] in CI]
    return list(_cases(of, SETS[of] if seed is None else seed, encoder))


def _cases(of: str, first: int, encoder: float | None) -> Iterator[Case]:
    number = 0
    for category, machines in CATEGORIES.items():
        for mechanism, entries in machines.items():
            for k, hidden in enumerate(entries):
                number += 1
                noise = (0.01, 0.03)[(number + (first > 0)) % 2]
                what = " + ".join(str(h).rstrip(":") for h in hidden) or str(k + 1)
                yield Case(
                    name=f"{of}/{category}/{mechanism}/{what}",
                    category=category,
                    mechanism=mechanism,
                    hidden=hidden,
                    size=0.25 if category == "quarter" else 1.0,
                    noise=noise,
                    encoder=noise if encoder is None else encoder,
                    motion=first + 1 + k % MOTIONS,
                    seed=first + number,
                )


def every_case() -> list[Case]:
    return [case for of in SETS for case in cases(of)]


def count(chosen: Sequence[Case]) -> dict[str, int]:
    """Cases by category."""
    return {c: sum(case.category == c for case in chosen) for c in CATEGORIES}


if __name__ == "__main__":
    for of in (*SETS, "ci"):
        print(of, count(cases(of)))
    print(sorted({h.kind for case in every_case() for h in case.hidden}))
