"""Joints that are logged beyond the degrees of freedom, against the closures."""

from __future__ import annotations

import numpy as np

from ident.fit import Fit
from ident.health.channels import Channels
from ident.health.check import Check
from ident.motion.spectrum import noise_level

NOISE = 5.0  # times the channel's own noise
TURN = 1.0  # rad; a joint that turns on and on has no larger motion than this
MATERIAL = 0.005  # of the joint's own motion: smaller misses change no torque that one could see


def disagreement(fit: Fit, data: Channels) -> list[Check]:
    """How far logged joints are from where closures and the other joints put them."""
    mechanism = fit.mechanism
    by_log = {e.name: e for e in fit.motion.experiments}
    found = []
    for log in data.logs if mechanism.closures else ():
        own = [c for c in data.of("q") if c.log == log.name]
        e = by_log.get(log.name)
        if e is None or len(own) <= mechanism.degrees_of_freedom:
            continue
        for channel in own:
            joint = mechanism.joint(channel.name.removeprefix("q."))
            at = mechanism.joint_index[joint.name]
            inside = (channel.t >= e.t[0]) & (channel.t <= e.t[-1])
            off = channel.x[inside] - np.interp(channel.t[inside], e.t, e.y[:, at])
            if joint.rotational:
                off = (off + np.pi) % (2 * np.pi) - np.pi
            rms, mean = float(np.sqrt(np.mean(off**2))), float(np.mean(off))
            spread = max(float(np.std(channel.x)), 1e-300)
            spread = min(spread, TURN) if joint.rotational else spread
            share, noise = rms / spread, noise_level(channel.x)
            bad = share > MATERIAL and rms > NOISE * noise
            like = (
                "a constant: an encoder's offset"
                if abs(mean) > 0.8 * rms
                else "changing with position: a length or a joint's placement"
            )
            text = (
                f"{log.name}: differs by {rms:.3g} {joint.unit} rms from where the closures and "
                f"the other joints put it" + (f", {like}" if bad else "")
            )
            remedy = (
                f"check the zero of {channel.name} ([log] offset) and the closures' lengths and "
                "frames"
            )
            found.append(
                Check(
                    "closure", (channel.name,), share, MATERIAL, bad, text, remedy, "of its motion"
                )
            )
    return found
