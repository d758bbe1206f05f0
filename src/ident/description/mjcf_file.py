"""A MuJoCo model's file compiled by MuJoCo, after what it includes has been looked at."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ident.description.check_urdf import parse_xml
from ident.errors import MechanismError

if TYPE_CHECKING:
    import mujoco

DEEPEST = 20  # includes within includes
MOST = 500  # joints


def compiled(path: Path, data: bytes) -> tuple[mujoco.MjModel, list[str]]:
    """The model that MuJoCo makes of a file, and its warnings.

    Raises:
        MechanismError: if MuJoCo is not installed or refuses the file, or the file includes one
            from outside of its folder, bends, or has very many joints.
    """
    try:
        import mujoco
    except ImportError:
        raise MechanismError(
            f'{path}: reading MuJoCo models needs MuJoCo: pip install "ident[mjcf]", or give a URDF'
        ) from None
    _check_includes(path, data, path.parent.resolve(), ())
    said: list[str] = []
    before = getattr(mujoco, "get_mju_user_warning", lambda: None)()  # not in every version
    mujoco.set_mju_user_warning(said.append)  # else it writes a MUJOCO_LOG.TXT where one stands
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except Exception as error:  # a compiler given anything: every fault is the file's
        what = " ".join(str(error).split())[:300]
        raise MechanismError(f"{path}: MuJoCo refuses it: {what or type(error).__name__}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if model.nflex:
        raise MechanismError(f"{path}: has flexible bodies (flex); a mechanism is of rigid ones")
    if model.njnt > MOST:
        raise MechanismError(f"{path}: {model.njnt} joints; a mechanism has at most {MOST}")
    return model, [f"MuJoCo: {' '.join(each.split())}" for each in said]


def _check_includes(path: Path, data: bytes, folder: Path, above: tuple[Path, ...]) -> None:
    if len(above) > DEEPEST or path.resolve() in above:
        raise MechanismError(f"{path}: includes itself; remove that <include>")
    for include in parse_xml(data, str(path)).iter("include"):
        name = include.get("file") or ""
        file = (folder / name).resolve()  # MuJoCo: of the main file's folder
        if folder not in file.parents:
            raise MechanismError(
                f"{path}:{include.sourceline}: includes '{name}', outside of the model's folder; "
                "copy it into that"
            )
        try:
            inside = file.read_bytes()
        except OSError as error:
            raise MechanismError(
                f"{path}:{include.sourceline}: includes '{name}', which cannot be read: "
                f"{error.strerror}"
            ) from None
        _check_includes(file, inside, folder, (*above, path.resolve()))
