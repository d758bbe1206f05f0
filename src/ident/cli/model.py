"""`add`, `effects` and `view`."""

from __future__ import annotations

import os
from pathlib import Path

from ident.cli.console import notes, progress, result
from ident.cli.options import (
    Absolute,
    AllowCode,
    Lock,
    MechanismPath,
    Paths,
    Smoothing,
    argument,
    kinds_beginning,
    mechanism_of,
    motion_of,
    output_file,
    setting,
    with_effect,
)
from ident.errors import IdentError


def add(
    mechanism: MechanismPath,
    effect: list[str] = argument(
        "One or several, as viscous:elbow, viscous for all driven joints, or "
        "file.py:function:elbow.",
        "EFFECT",
        default=...,
        autocompletion=kinds_beginning,
    ),
    allow_code: AllowCode = False,
) -> None:
    """Write effects into mechanism.toml.

    A bare URDF gets a mechanism.toml beside it.
    """
    from ident.mechanism.write import add_effects

    before = mechanism_of(mechanism, allow_code=allow_code)
    after = before
    for each in effect:
        after = with_effect(after, each, allow_code=allow_code)
    new = [each for each in after.effects if each not in before.effects]
    path = add_effects(before, new)
    if before.toml is None:
        notes([f"{mechanism} by itself stays as it is: from now on give {path} in its place"])
    result(f"{path}: added {', '.join(each.label for each in new)}")


def effects(
    kind: str | None = argument(
        "One of them, as viscous; else all.", "KIND", default=None, autocompletion=kinds_beginning
    ),
) -> None:
    """List the library of effects.

    Equation, unknowns and shapes with units, where an effect sits, and what a residual looks like
    when it is missing.
    """
    from ident.effects import KINDS, kind_of
    from ident.show.effects import described

    kinds = KINDS.values() if kind is None else [kind_of(kind)]
    result("\n\n".join(described(each) for each in kinds))


def view(
    mechanism: MechanismPath,
    logs: Paths = argument("Without one the mechanism stands still.", "LOG", default=None),
    fit: Path | None = setting("Fit whose reactions and residuals are shown.", "FIT.json"),
    port: int = setting("Port of the page, on 127.0.0.1; 0: a free one.", "N", default=0),
    out: Path | None = setting("Write the page, and no server.", "FILE.html"),
    mesh_path: Paths = setting("Packages of package://, as ROS_PACKAGE_PATH.", "DIR"),
    smoothing: Smoothing = "auto",
    lock: Lock = None,
    absolute: Absolute = False,
    allow_code: AllowCode = False,
) -> None:
    """Show the moving mechanism in 3-D, in a browser.

    With a fit, closures' reactions are arrows, joints are coloured by their residual, and charts of
    the torque follow the same cursor. The page is served on this machine alone, until Ctrl-C.
    """
    from ident.display import render
    from ident.fit.files import read_fit
    from ident.fit.prediction import predict
    from ident.fit.residual import residual_of
    from ident.show.view3d.page import SUFFIXES

    output_file(out, SUFFIXES, logs or ())
    if fit is not None and not logs:
        raise IdentError(f"--fit {fit}: a fit can be shown with a motion only; give a LOG too")
    for folder in reversed(mesh_path or ()):
        if not folder.is_dir():
            raise IdentError(f"--mesh-path {folder}: is no folder; give one that contains packages")
        known = os.environ.get("ROS_PACKAGE_PATH", "")
        os.environ["ROS_PACKAGE_PATH"] = f"{folder.resolve()}{os.pathsep}{known}"
    model = mechanism_of(mechanism, allow_code=allow_code, absolute=absolute, lock=lock, logs=logs)
    saved = None if fit is None else read_fit(fit, model, allow_code=allow_code)
    model = model if saved is None else saved.mechanism
    with progress() as on_progress:
        if logs:
            # torques are needed only where a residual is shown
            motion = motion_of(model, logs, "auto", on_progress, saved is not None, smoothing)
        if saved is not None:
            residual = residual_of(saved, motion)
            shown = render(residual, "view", predict(model, motion, saved.point))
        else:
            shown = render(model, "view", motion.experiments if logs else ())
        if out is not None:
            shown.write(out)
    notes(shown.notes)
    if out is not None:
        count = shown.moments
        result(f"{out}: {count} moment{'s' * (count != 1)}; open it in a browser")
        return
    with shown.serve(port) as page:
        result(f"{page.address}    (Ctrl-C ends it)")
        try:
            page.wait()
        except KeyboardInterrupt:
            return
