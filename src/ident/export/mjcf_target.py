"""The target `mjcf`: a model written anew, or the user's own with other numbers."""

from __future__ import annotations

import numpy as np

from ident.errors import IdentError
from ident.export.fitted import exact_motion, fit_numbers
from ident.export.laws import felt_inertia
from ident.export.machine import Machine
from ident.export.mjcf import STEP, WORDS, Numbers, suffix, write_mjcf
from ident.export.mjcf_like import LikeMjcf
from ident.export.rollout import compiled
from ident.export.target import Job, Product, Target, translated

INSTALLED = 'to fit numbers to MuJoCo\'s own laws, install it: pip install "ident[mjcf]"'


def write(job: Job) -> Product:
    """Return the model of a job."""
    translation = translated(job, WORDS)
    like = None if job.like is None else LikeMjcf(job.like, job.machine)
    step = job.step or (like.step if like else STEP)
    check_step(job.machine, step)
    soft = like.soft if like else 2 * step
    numbers = Numbers(step, soft)
    make = like.text if like else write_mjcf
    notes: list[str] = []
    if job.fitted:
        try:
            compiled(make(translation, numbers))
            exact = exact_motion(job.machine)
            result = fit_numbers(
                translation, numbers, exact, soft=like is None, text=make, progress=job.progress
            )
            translation, numbers = result.translation, result.numbers
            notes += result.notes
        except IdentError as error:
            notes.append(
                INSTALLED
                if "needs MuJoCo" in str(error)
                else f"numbers are the physical ones: {error}"
            )
    name = job.out.name
    return Product({name: make(translation, numbers)}, translation, tuple(notes))


def check_step(machine: Machine, step: float) -> None:
    """Refuse a step with which a drive's stiffness is unstable: kp dt² / m < 1, half of what the
    semi-implicit method allows.
    """
    inertia = felt_inertia(machine)
    for (joint, *_), servo in machine.values.get("servo", {}).items():
        longest = float(np.sqrt(inertia[joint] / servo["kp"]))
        if step > longest:
            raise IdentError(
                f"step {step:g} s: too long for the drive of '{joint}' (kp dt² / inertia = "
                f"{servo['kp'] * step**2 / inertia[joint]:.3g}, above 1); at most --step "
                f"{longest:.2g}"
            )


MJCF = Target("mjcf", "a MuJoCo model", suffix, WORDS, write, (".xml", ".mjcf"))
