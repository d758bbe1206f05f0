"""Drives without a torque sensor: the torque of a joint from the command that its drive follows.

    servo          τ = kp (ref(t − delay) − q) + kd (dref − q̇) + feedforward,      |τ| ≤ limit
    motor_current  τ = kt · current(t − delay)
    motor_voltage  τ = gain · voltage(t − delay) − kb q̇                            back-EMF
    motor_duty     τ = gain · duty(t − delay) · supply − kb q̇

A drive corrects the torque channel of its joint, as `delay` corrects its time: residuals, held-out
errors, a diagnosis and a monitor see a torque like any other. Its scale (kp, kt, gain) enters the
equations by what the model predicts for the drive, never by the noisy column ref − q: an error in
the column would shrink the scale. Source of the argument: W. Fuller, Measurement Error Models,
1987, sect. 1.1. A drive that is off (`on.<joint>` is 0) has no torque, which is known exactly.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ident.effects.command import late_command, linear_samples
from ident.effects.drive import KHALIL
from ident.effects.effect import NOWHERE, Bounds, Correcting, Correction, Shape, Signals, Unknown
from ident.information import linear

LATEST_COMMAND = 0.05  # range: [s] by which a drive may follow its command late
ITS_OWN = 0.1  # numerics: share of a torque that neither speed nor acceleration makes, at least
SCALE_RANGE = 30.0  # range: times above and below its start that a drive's scale is searched


PREFIX = "command_delay."
# begins a column that is made, not logged: for how long [s] a joint's command is held, 0 if it
# goes straight on between samples, AS_IT_ACTS if the samples are what acts
HOLD = "(time that a command is held) "
AS_IT_ACTS = -1.0  # numerics


class CommandDelay(Correcting):
    """A time by which drives follow their commands late, the same for all on one bus."""

    kind = "command_delay"
    noun = "late command"
    shared = True
    sits = "driven"
    candidate_sites = "commanded"
    through_drives = True
    margin = LATEST_COMMAND
    shapes = (
        Unknown(
            "d", ("s", "s"), "by which drives follow late", True, range=(0.0, LATEST_COMMAND)
        ),
    )  # fmt: skip
    equation = "τ = kp (ref(t − d) − q) + …"
    signature = "the residual follows the rate of the command"
    confused_with = ("viscous", "kd of a servo")
    remedy = "log a faster command, or with the drive off for a second"
    source = "Björklund, Ljung, IEEE CDC 2003"


@dataclass(frozen=True)
class Drive(Correcting):
    """A drive whose torque is computed from its command: scale · error + offset, within limits."""

    sits = "driven"
    candidate_sites = NOWHERE
    implicit = True
    supplies_torque: ClassVar[bool] = True
    commands: ClassVar[tuple[str, ...]] = ()  # columns of the joint that it must have
    late: ClassVar[tuple[str, ...]] = ()  # and of those that it may read, which act late
    settings: ClassVar[Mapping[str, float]] = {
        "limit": np.inf, "delay": 0.0, "linear": 0.0,
    }  # fmt: skip

    def reads(self) -> tuple[str, ...]:
        return tuple(f"{command}.{self.joints[0]}" for command in self.commands)

    def command(self, s: Signals, name: str) -> np.ndarray | None:
        """Return a command (n,) of the joint as its drive has it: late, and held between samples.

        What filtered rows show of a command that is held; of one that was not completed yet, a
        line half a sample late.
        """
        x = s.extra.get(f"{name}.{self.joints[0]}")
        if x is None or len(s.t) < 2:
            return x
        hold = s.extra.get(HOLD + self.joints[0])  # of the log: signals may have fewer samples
        if hold is None:
            return np.interp(s.t - self.delay(s) - 0.5 * (s.t[1] - s.t[0]), s.t, x)
        if hold[0] == AS_IT_ACTS:
            return x
        return late_command(s.t, x, self.delay(s), float(hold[0]))

    def goes_straight(self, columns: Mapping[str, np.ndarray]) -> bool:
        """Whether the command goes straight on between samples: as stated, or as it does over
        several samples of a log with these columns.
        """
        stated = self.values.get("linear")
        commands = (columns.get(name) for name in self.reads())
        if stated is None:
            return any(x is not None and linear_samples(x) > 1 for x in commands)
        return stated > 0.5

    def delay(self, s: Signals) -> float:
        """Return the time [s] by which the drive is late: its own, and that of its bus."""
        common = (
            value
            for name, value in s.present.items()
            if name.startswith(PREFIX)
            and self.joints[0] in name.removeprefix(PREFIX).removesuffix(".d").split(",")
        )
        return self.setting("delay") + sum(common)

    @abstractmethod
    def error(self, s: Signals) -> np.ndarray:
        """Return what the scale multiplies (n,)."""

    @abstractmethod
    def offset(self, s: Signals) -> np.ndarray:
        """Return the torque (n,) that does not depend on the scale [N m | N]."""

    def gain(self, s: Signals) -> np.ndarray:
        """Return the gain (n,) of the firmware in each sample, 1 where the log has none."""
        return s.extra.get(f"{self.scale}.{self.joints[0]}", np.ones(len(s.t)))

    def unlimited(self, s: Signals) -> np.ndarray:
        """Return the torque (n,) [N m | N] that the law asks for, within limits or not."""
        return s.shape[self.scale] * self.gain(s) * self.error(s) + self.offset(s)

    def torque(self, s: Signals) -> np.ndarray:
        """Return the torque (n,) [N m | N] of the drive at the shape `s.shape`."""
        limit = self.setting("limit")
        torque = np.clip(self.unlimited(s), -limit, limit)
        on = s.extra.get(f"on.{self.joints[0]}")
        return torque if on is None else np.where(on > 0.5, torque, 0.0)

    def correction(self, s: Signals) -> Correction:
        return Correction(torque={self.joints[0]: self.torque(s)})

    def scale_column(self, s: Signals, predicted: np.ndarray) -> np.ndarray:
        free = np.where(self._unlimited(s), predicted - self.offset(s), 0.0)
        return free / s.shape[self.scale]

    def _commanded(self, s: Signals) -> bool:
        return s.extra.keys() >= {*self.reads()}

    def _unlimited(self, s: Signals) -> np.ndarray:
        """Where (n,) the torque follows the scale: the drive is on, and not at its limit."""
        if not self._commanded(s):
            return np.ones(len(s.t), dtype=bool)
        on = s.extra.get(f"on.{self.joints[0]}", np.ones(len(s.t)))
        return (on > 0.5) & (np.abs(self.torque(s)) < self.setting("limit"))

    def _start(self, s: Signals) -> tuple[float, float]:
        """Return the scale with which the drive makes what the present model predicts, beside a
        rotor and friction that it may lack, and the damping [N m s/rad | N s/m] of both.

        The predicted torque is the regressor: it has less noise than the command's error.
        """
        if not self._commanded(s):  # a motion that was made up
            return 1.0, 0.0
        known = {**{shape.name: 0.0 for shape in self.shapes}, **self.values}
        with_known = Signals(s.t, s.q, s.v, s.a, s.still, s.extra, known, s.present, s.predicted)
        needed = s.torque[:, 0] - self.offset(with_known)
        error = self.gain(s) * self.error(with_known)
        v = s.v[:, 0]
        passive = np.stack([v, s.a[:, 0], np.sign(v), np.ones_like(v)], axis=1)
        active = needed - passive @ linear.lstsq(passive, needed, rcond=1e-9)[0]
        if active @ active > ITS_OWN**2 * (needed @ needed):
            A = np.column_stack([needed, passive])
            share, damping = linear.lstsq(A, error, rcond=1e-9)[0][:2]
            if share > 0:
                return float(1 / share), max(0.0, float(damping / share))
        product, size = float(error @ needed), float(error @ error)
        return product / size if product > 0 and size > 0 else 1.0, 0.0

    def starts(self, s: Signals) -> list[Shape]:
        scale, damping = self._start(s)
        return [{**{shape.name: damping for shape in self.shapes}, self.scale: scale}]

    def bounds(self, s: Signals) -> Bounds:
        # another shape is a damping: as much as makes the drive's largest torque at its speed
        start, _ = self._start(s)
        now = s.shape.get(self.scale) or start
        speed = float(np.sqrt(np.mean(s.v**2))) or 1.0
        error = self.gain(s) * self.error(s) if self._commanded(s) else np.ones(1)
        largest = float(np.sqrt(np.mean(error**2))) * now or 1.0
        ranges = {shape.name: (0.0, SCALE_RANGE * largest / speed) for shape in self.shapes}
        return {
            **ranges,
            self.scale: (min(start, now) / SCALE_RANGE, max(start, now) * SCALE_RANGE),
        }


class Servo(Drive):
    """A position or velocity servo: its torque from the command that it follows and the motion."""

    kind = "servo"
    noun = "servo drive"
    commands = ("ref",)
    late = ("ref", "dref", "feedforward")
    scale = "kp"
    settings: ClassVar = {**Drive.settings, "follows_velocity": 0.0}
    shapes = (
        Unknown("kp", ("N m/rad", "N/m"), "stiffness of the servo", True),
        Unknown("kd", ("N m s/rad", "N s/m"), "its damping, on q̇", True),
    )
    equation = "τ = kp (ref(t − delay) − q) + kd (dref − q̇) + feedforward, |τ| ≤ limit"
    signature = "the log has commands ref.<joint> and no torques"
    confused_with = ("viscous: kd and viscous friction are one column where the drive is not off",)
    remedy = "log once more with a known mass, or with the drive off for a second"
    source = KHALIL

    def error(self, s: Signals) -> np.ndarray:
        ref = self.command(s, "ref")
        assert ref is not None
        return ref - s.q[:, 0]

    def offset(self, s: Signals) -> np.ndarray:
        wanted = self.command(s, "dref")
        follows = self.setting("follows_velocity") > 0.5 and wanted is not None
        feedforward = self.command(s, "feedforward")
        rate = (wanted if follows else 0.0) - s.v[:, 0]
        damping = s.extra.get(f"kd.{self.joints[0]}", np.ones(len(s.t)))
        torque = s.shape["kd"] * damping * rate
        return torque if feedforward is None else torque + feedforward


class MotorCurrent(Drive):
    """A motor whose current is logged: its torque is the current times the motor's constant."""

    kind = "motor_current"
    noun = "motor constant"
    commands = ("current",)
    late = ("current",)
    scale = "kt"
    shapes = (Unknown("kt", ("N m/A", "N/A"), "torque constant at the joint", True),)
    equation = "τ = kt current"
    signature = "the log has currents and no torques"
    confused_with = ("all inertias and frictions at once, where no body is known",)
    remedy = "log once more with a known mass"
    source = KHALIL

    def goes_straight(self, columns: Mapping[str, np.ndarray]) -> bool:
        return True  # it is measured

    def error(self, s: Signals) -> np.ndarray:
        return s.extra[f"current.{self.joints[0]}"]

    def offset(self, s: Signals) -> np.ndarray:
        return np.zeros(len(s.t))


class MotorVoltage(Drive):
    """A motor that is driven by volts, or by a duty cycle of its supply, against its back-EMF."""

    kind = "motor_voltage"
    noun = "motor driven by volts"
    commands = ("voltage",)
    late: ClassVar[tuple[str, ...]] = ("voltage",)
    scale = "gain"
    shapes = (
        Unknown("gain", ("N m/V", "N/V"), "torque a volt, at standstill", True),
        Unknown("kb", ("N m s/rad", "N s/m"), "torque that the back-EMF takes, a speed", True),
    )
    equation = "τ = gain voltage(t − delay) − kb q̇"
    signature = "the log has voltages and no torques"
    confused_with = ("viscous: kb and viscous friction are one column",)
    remedy = "log once more with a known mass, or with the drive off for a second"
    source = KHALIL

    def error(self, s: Signals) -> np.ndarray:
        volts = self.command(s, "voltage")
        assert volts is not None
        return volts

    def offset(self, s: Signals) -> np.ndarray:
        return -s.shape["kb"] * s.v[:, 0]


class MotorDuty(MotorVoltage):
    """A motor that is driven by a share of its supply, against its back-EMF."""

    kind = "motor_duty"
    noun = "motor driven by a duty cycle"
    commands = ("duty",)
    late = ("duty", "supply")
    shapes = (
        Unknown("gain", ("N m", "N"), "torque at full duty, a volt where supply is logged", True),
        Unknown("kb", ("N m s/rad", "N s/m"), "torque that the back-EMF takes, a speed", True),
    )
    equation = "τ = gain duty(t − delay) supply − kb q̇"
    signature = "the log has duty cycles and no torques"

    def units_with(self, columns: Collection[str]) -> tuple[str, ...]:
        if f"supply.{self.joints[0]}" not in columns:
            return self.units
        return MotorVoltage(self.joints, rotational=self.rotational).units

    def error(self, s: Signals) -> np.ndarray:
        duty, supply = self.command(s, "duty"), self.command(s, "supply")
        assert duty is not None
        return duty if supply is None else duty * supply
