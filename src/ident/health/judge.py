"""The verb `health`: what is wrong with the logged data, before any missing effect is named."""

from __future__ import annotations

from collections.abc import Sequence

from ident.fit import Fit
from ident.health.channels import channels
from ident.health.clipped import clipped
from ident.health.closed import disagreement
from ident.health.command import commands
from ident.health.delay import delays
from ident.health.grain import grains
from ident.health.health import Health
from ident.health.positions import moved
from ident.health.prior import magnitudes
from ident.health.record import clock, dead, repairs
from ident.health.remainder import free
from ident.health.torques import exchanged, negative
from ident.health.trial import Trial
from ident.health.useless import useless
from ident.log import Log


def health(fit: Fit, logs: Sequence[Log] = ()) -> Health:
    """The health of the data behind a fit.

    Args:
        fit: from `identify`.
        logs: those the fit was made from, as read. With them quantisation, staircases, jitter and
            the closure residual are judged on the samples as logged; without, on the motion's
            uniform clock, where positions are smoothed already and are not judged.

    Returns:
        All checks, bad ones first; `print` shows a table and the findings in words.
    """
    data, trial = channels(fit, logs), Trial.of(fit)
    arranged = exchanged(fit, trial)
    wrong = any(check.bad for check in arranged)
    if not wrong:
        arranged += moved(fit, trial)
        wrong = any(check.bad for check in arranged)
    swinging = free(fit)
    idle = frozenset(check.channels[0].removeprefix("tau.") for check in swinging)
    checks = [
        *arranged,  # what follows is judged by the model, which wrong channels spoil
        *([] if wrong else [*swinging, *magnitudes(fit, trial), *delays(fit, trial, idle)]),
        *negative(fit),
        *commands(fit, data),
        *clipped(fit, data),
        *grains(fit, data),
        *disagreement(fit, data),
        *dead(fit, data),
        *clock(data),
        *repairs(fit),
        *useless(fit, trial),
    ]
    return Health(tuple(sorted(checks, key=lambda check: not check.bad)))
