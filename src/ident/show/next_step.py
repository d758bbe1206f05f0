"""The next step in a sentence, which stands with its command: what it does, and why."""

from __future__ import annotations

from ident.effects.library import create, named
from ident.request import Step
from ident.show.repairs import repair_words

WATCH = (
    "nothing has to be done: the model predicts to the noise. To watch the machine, log a minute "
    "or more of normal running, which `ident monitor --like` compares with what comes."
)
WORDS = {
    "check": "see what was understood of the log.",
    "compare": "see where the model fails.",
    "diagnose": "find what is missing.",
    "explore": "no effect explains what is left: try effects by hand, and see the error fall.",
    "grow": "add all effects that are missing, one after the other, until none is.",
    "identify": "identify the parameters.",
    "monitor": "watch the machine: what comes is compared with these logs.",
}
TEST = (
    "test the model on another motion. This command plans one; give the log of it as `--validate`."
)


def step_words(step: Step, *, fits: bool = False, validated: bool = False) -> str:
    """Return what a step does, as a sentence behind `Next:`; `fits`: whether the model's error is
    noise or small, `validated`: on a log that was held back.
    """
    match step.verb:
        case "":
            return WATCH if fits else ""
        case "add" if step.files:
            return "take the formula into the model, and compare it in a log of another motion."
        case "add":
            return f"add {effects_of(step)}."
        case "diagnose" if step.known:
            return "find the cause of the change, with the earlier bodies known."
        case "identify" if step.repairs:
            return repair_words(step)
        case "identify" if step.effects:
            return f"identify with {effects_of(step)} too."
        case "excite" if step.separate:
            return f"log a motion that tells {' and '.join(step.separate)} apart."
        case "excite" if not step.range and not step.speed:
            return TEST if step.around else "plan a motion that determines most."
        case "excite":
            return "log another motion, which this command plans."
    return WORDS.get(step.verb, "")


def effects_of(step: Step) -> str:
    """Return the effects of a step in words; kinds of all drives, and those of files, as labels."""
    known, others = [], []
    for label in step.effects:
        kind, colon, joints = label.partition(":")
        if colon and ".py" not in kind and ":" not in joints:
            known.append(create(kind, joints))
        else:
            others.append(WHOLE.get(label, label))
    return " and ".join([*([named(known)] if known else []), *others])


WHOLE = {"viscous": "viscous friction", "coulomb": "dry friction"}  # of all drives
