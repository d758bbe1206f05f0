"""What tests of forward simulation share: effects planted, and torques judged."""

import numpy as np

import ident
from ident.equations.terms import Samples
from ident.equations.unknowns import Point
from ident.fit.prediction import predict


def planted(mechanism, effects):
    for label, values in effects.items():
        mechanism = mechanism.with_effect(label, values)
    return mechanism


def integrated(mechanism, log):
    """The run that follows a log. Torques are judged at its states, which need not be precise."""
    return ident.integrate(mechanism, ident.ComputedTorque(log), tolerance=1e-7)


def judged(mechanism, run):
    """Largest difference of predicted and acting torque, away from standstill, over the largest."""
    point = Point.prior(mechanism)
    motion = ident.complete(mechanism, run.log, cutoff=None)
    (e,) = motion.experiments
    (said,) = predict(mechanism, motion, point)
    moves = (np.abs(e.yd) > e.still).all(axis=1) & said.usable
    for effect in mechanism.effects:
        if effect.kind == "coupling":  # its own speed is the sum of two
            s = Samples(mechanism, e, slice(None), point).signals(effect.joints)
            moves &= effect.informed(s)[:, 0]
    assert moves.mean() > 0.5
    return np.abs(said.residual[moves]).max() / np.abs(said.measured).max()
