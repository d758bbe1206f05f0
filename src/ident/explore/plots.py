"""Pictures of an exploration: one joint before and now, all joints, the ladder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.diagnose.plots import plot_rungs
from ident.explore.rung import Rung
from ident.residual.plots import plot_maps, plot_predictions
from ident.show.charts import Chart

POINTS = 1500  # of a line on the page


def plot_joint(before: Rung, now: Rung, joint: str, experiment: int = 0) -> list[Chart]:
    """Torque of one joint with the last two models, and what is left against its signals.

    Args:
        before, now: two rungs; the same one twice is drawn once.
        joint: an independent one.
        experiment: number of the log.
    """
    rungs = {"now": now} if before is now else {"before": before, "now": now}
    predicted = {name: rung.fit.predict() for name, rung in rungs.items()}
    joints = now.fit.motion.independent
    unit = now.fit.mechanism.joint(joint).force_unit
    whole = plot_predictions(predicted, [unit] * len(joints), experiment)
    u = joints.index(joint)
    torque = replace(
        whole,
        words=f"Measured and predicted torque of {joint} over time",
        rows=whole.rows[2 * u : 2 * u + 2],
    )
    return [torque.thinned(POINTS), plot_maps({"now": now.fit.residual}, joint)]


def plot_all(now: Rung, experiment: int = 0) -> Chart:
    """Measured and predicted torque of every joint, and the difference."""
    return now.fit.plot(experiment).thinned(POINTS)


def plot_ladder(rungs: Sequence[Rung]) -> Chart:
    """Held-out error of every joint, rung by rung."""
    return plot_rungs([rung.name for rung in rungs], [rung.errors for rung in rungs])
