"""Arguments and options that several commands share, their values, and the files they name."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer

from ident.cli.app import command_line, notes_later
from ident.cli.lines import ShellRequest
from ident.errors import FitError, IdentError
from ident.files import check_writable

if TYPE_CHECKING:
    from ident.display import Progress
    from ident.fit.files import Saved
    from ident.log import Log
    from ident.mechanism import Mechanism
    from ident.motion import Motion

LOOKED_AT = 8  # work: logs of which columns are read before hands count as not logged
LOGS = (".csv", ".parquet", ".npz")  # suffixes of logs that can be written
CHARTS = (".png", ".svg", ".pdf", ".html")  # suffixes of charts
FIT_FILES = ("fit.json", "multipliers.csv", "identified.urdf", "report.html", "identified")
DIAGNOSIS_FILES = ("diagnosis.json", "report.html")


def option(text: str, metavar: str | None = None, *names: str, **more: Any) -> Any:
    """Return an option with its help, the word for its value, and its names if not its own."""
    return typer.Option(*names, metavar=metavar, help=text, **more)


def setting(text: str, metavar: str, *names: str, default: object = None, **more: Any) -> Any:
    """Return an option of one command alone, as the default value of its parameter."""
    return typer.Option(default, *names, metavar=metavar, help=text, **more)


def flag(text: str, name: str) -> Any:
    """Return an option without a value, as the default value of its parameter."""
    return typer.Option(False, name, help=text)


def argument(text: str, metavar: str, **more: Any) -> Any:
    """Return an argument with its help."""
    return typer.Argument(metavar=metavar, help=text, **more)


def kinds_beginning(incomplete: str) -> list[tuple[str, str]]:
    """Return kinds of effects for the Tab key. No joints: a colon separates words in bash."""
    from ident.effects import KINDS

    return [
        (name, effect.equation) for name, effect in KINDS.items() if name.startswith(incomplete)
    ]


Texts = list[str] | None
Paths = list[Path] | None
MechanismPath = Annotated[
    Path, argument("A folder with mechanism.toml, or a .urdf or a MuJoCo .xml.", "MECHANISM")
]
LogPaths = Annotated[
    list[Path], argument(".csv, .parquet, .npz, ROS 2 bags or .mcap; or folders of them.", "LOG")
]
With = Annotated[
    Texts,
    option(
        "Add an effect, as viscous:elbow, viscous for all driven joints, or one of your own, "
        "file.py:function:elbow.",
        "EFFECT",
        "--with",
        autocompletion=kinds_beginning,
    ),
]
Lock = Annotated[Texts, option("Hold a joint at rad or m, or at its start.", "JOINT[=VALUE]")]
DriveTexts = Annotated[
    Texts,
    option(
        "Compute a joint's torque from its command, as elbow:kp=20,kd=1.5, kp=20 for all joints, "
        "or servo.",
        "JOINT:KEY=VALUE",
        "--drive",
    ),
]
Unmeasured = Annotated[Texts, option("Leave out the equation of a joint without sensor.", "JOINT")]
MeshPath = Annotated[Paths, option("Packages of package://, as ROS_PACKAGE_PATH.", "DIR")]
AllowCode = Annotated[
    bool, option("Run Python files that mechanism.toml or --with names.", None, "--allow-code")
]
Cutoff = Annotated[str, option("Cut-off of the zero-phase filter: a number, auto or none.", "HZ")]
Smoothing = Annotated[
    str, option("Distance of the motion's knots, auto, or none for channels as they are.", "S")
]
Poses = Annotated[
    bool,
    option("Each row is a machine at rest, in any order. Default: as rows look.", None, "--poses"),
]
Basis = Annotated[
    str | None, option("Time basis of the multipliers: free, linear, cubic or quintic.", "NAME")
]
Spacing = Annotated[float | None, option("Distance of the basis' knots in seconds.", "S")]
Absolute = Annotated[bool, option("Work in absolute coordinates, six a body.", None, "--absolute")]
Plot = Annotated[Path | None, option("Draw it into this .png, .svg, .pdf or .html.", "FILE")]
Seed = Annotated[int, option("Seed of the noise.", "N", min=0)]
Calibrated = Annotated[
    list[str] | None,
    option(
        "How well it is calibrated, one standard deviation: tau=0.5%,q=0.1deg,clock=exact; exact.",
        "TEXT",
    ),
]
Json = Annotated[
    bool, option("Print one line of JSON, the content of the file, not text.", None, "--json")
]
GoodEnough = Annotated[
    float | None,
    option(
        "End with status 3 where an error is above this and above noise; 0: above noise.",
        "PERCENT",
        min=0,
    ),
]
Jobs = Annotated[int | None, option("Processes on this machine. Default: one a core.", "N")]
Scheduler = Annotated[
    str | None, option("Dask scheduler whose workers do it, as tcp://host:8786.", "ADDRESS")
]


# Groups of options: a command has a parameter of the class, the command line all of its fields.
@dataclass(frozen=True)
class MechanismOptions:
    """The mechanism of a path."""

    mechanism: MechanismPath
    lock: Lock = None
    unmeasured: Unmeasured = None
    drive: DriveTexts = None
    calibrated: Calibrated = None
    mesh_path: MeshPath = None
    allow_code: AllowCode = False

    def request(
        self,
        logs: Paths = None,
        *,
        like: Paths = None,
        out: Path | None = None,
        good_enough: float | None = None,
        validate: Paths = None,
        of_fit: Sequence[str] = (),
    ) -> ShellRequest:
        """Return what the command is asked for; `good_enough` in percent, `of_fit`: options that
        `identify` alone has, as words.
        """
        words: list[str] = []
        for field in fields(self):
            given, name = getattr(self, field.name), field.name.rstrip("_").replace("_", "-")
            if field.default is not MISSING and given != field.default:
                for one in given if isinstance(given, list) else [given]:
                    words += [f"--{name}"] if one is True else [f"--{name}", str(one)]
        return ShellRequest(
            str(self.mechanism),
            tuple(map(str, logs or [Path("LOG.csv")])),
            tuple(words),
            tuple(map(str, like or ())),
            folder="" if out is None else str(out),
            acceptable=None if good_enough is None else good_enough / 100,
            command=command_line(),
            of_fit=tuple(of_fit),
            validate=tuple(map(str, validate or ())),
        )

    def load(self, logs: Paths = None, like: Paths = None) -> Mechanism:
        """Return the mechanism that the options describe.

        Hands and fingers of which the first of the logs, or of those `like` it, has no column are
        held at their start.
        """
        from ident.mechanism import load

        for place in reversed(self.mesh_path or ()):
            if not place.is_dir():
                why = "is no folder; give one that contains packages"
                raise IdentError(f"--mesh-path {place}: {why}")
            known = os.environ.get("ROS_PACKAGE_PATH", "")
            os.environ["ROS_PACKAGE_PATH"] = f"{place.resolve()}{os.pathsep}{known}"
        bare = [text for text in self.lock or () if "=" not in text]
        valued = [text for text in self.lock or () if "=" in text]
        remedy = "is no joint with a number; write --lock JOINT to hold it at its start, or "
        remedy += "--lock JOINT=VALUE in rad or m, as --lock finger=0.02"
        places = named(valued, "--lock", remedy, finite)
        if both := next((name for name in bare if name in places), None):
            why = f"{both} and --lock {both}={places[both]:g}: "
            why += "are two places for one joint, its start"
            raise IdentError(f"--lock {why} and a value; give one of them")
        locked = dict.fromkeys(bare) | places
        read = partial(
            load, self.mechanism, allow_code=self.allow_code, unmeasured=self.unmeasured or ()
        )
        mechanism = read(locked=locked).with_drives(*(self.drive or ()))
        if hands := _unlogged_hands(mechanism, like or logs):
            locked |= dict.fromkeys(hands)
            mechanism = read(locked=locked).with_drives(*(self.drive or ()))
            notes_later([f"{', '.join(hands)}: not logged, and parts of a hand; held at the start"])
        for text in self.calibrated or ():
            mechanism = mechanism.with_calibration(text)
        return mechanism


@dataclass(frozen=True)
class ModelOptions(MechanismOptions):
    """The mechanism with further effects."""

    with_: With = None

    def load(self, logs: Paths = None, like: Paths = None) -> Mechanism:
        """Return the mechanism with the effects."""
        mechanism = super().load(logs, like)
        for effect in self.with_ or ():
            mechanism = with_effect(mechanism, effect, allow_code=self.allow_code)
        return mechanism


@dataclass(frozen=True)
class MotionOptions(MechanismOptions):
    """The mechanism and the treatment of logs."""

    cutoff: Cutoff = "auto"
    smoothing: Smoothing = "auto"
    poses: Poses = False
    absolute: Absolute = False

    def load(self, logs: Paths = None, like: Paths = None) -> Mechanism:
        """Return the mechanism, in absolute coordinates if wanted."""
        from ident.mechanism.load import absolute

        mechanism = super().load(logs, like)
        return absolute(mechanism) if self.absolute else mechanism

    @property
    def treatment(self) -> dict[str, Any]:
        """The cut-off, `auto`, None or a frequency [Hz], and the smoothing, as the library's."""
        cutoff: float | str = self.cutoff
        if cutoff not in ("none", "auto"):
            valid = "is no frequency; valid: a number of Hz, auto or none"
            cutoff = value(self.cutoff, "--cutoff", valid)
        given = {"cutoff": cutoff, "smoothing": self.smoothing.lower()}
        named_none = {name: None if x == "none" else x for name, x in given.items()}
        return {**named_none, **({"poses": True} if self.poses else {})}

    def filtered_at(self, cutoff: float | str | None) -> Self:
        """Return the options with another cut-off [Hz], None for no filter."""
        return replace(self, cutoff="none" if cutoff is None else str(cutoff))

    def as_fitted(self, mechanism: Mechanism) -> tuple[Self, Saved | None]:
        """Return the options with the cut-off of the fit in whose folder the mechanism is, unless
        one is given, and that fit, if there is one: errors of both are then of one band.
        """
        from ident.fit.files import read_fit

        identified, fit = self.mechanism.name == "identified", None
        file = (self.mechanism.parent if identified else self.mechanism) / "fit.json"
        with suppress(*([FitError] if identified else [])):  # of another mechanism, or locked
            if file.is_file():
                fit = read_fit(file, mechanism, allow_code=self.allow_code)
        if fit is None or self.cutoff != "auto" or fit.cutoff == "auto":
            return self, fit
        return self.filtered_at(fit.cutoff), fit

    def motion(
        self,
        mechanism: Mechanism,
        logs: Sequence[Path | Log],
        on_progress: Progress | None = None,
        *,
        torques: bool = True,
    ) -> Motion:
        """Return the completed motion of logs, those in folders among them."""
        from ident.motion import complete

        paths = [log for log in logs if isinstance(log, Path)]
        poses = True if self.poses else None
        read = [log for log in logs if not isinstance(log, Path)]
        read += read_logs(mechanism, paths, poses)
        with naming_unused(mechanism):
            return complete(
                mechanism, read, torques=torques, progress=on_progress, **self.treatment
            )


@dataclass(frozen=True)
class RunOptions(MotionOptions, ModelOptions):
    """The mechanism with further effects, and the treatment of logs."""


@dataclass(frozen=True)
class FitOptions(RunOptions):
    """The mechanism with further effects, its multipliers, and the treatment of logs."""

    basis: Basis = None
    spacing: Spacing = None

    def load(self, logs: Paths = None, like: Paths = None) -> Mechanism:
        """Return the mechanism with another time basis of its multipliers, if one is given."""
        from ident.mechanism import multipliers

        mechanism = super().load(logs, like)
        if self.basis is None and self.spacing is None:
            return mechanism
        basis, spacing = self.basis or mechanism.multipliers.basis, self.spacing
        if basis == "free" and spacing is not None:
            raise IdentError(
                f"--spacing {spacing:g}: the basis is free, which has no knots; "
                "add --basis linear, cubic or quintic"
            )
        if spacing is None:
            spacing = 0.0 if basis == "free" else mechanism.multipliers.spacing
        return mechanism.with_same_kinematics(
            multipliers=multipliers(basis, spacing, "--basis, --spacing")
        )


@dataclass(frozen=True)
class DecisionOptions:
    """What it takes to name an effect."""

    alpha: Annotated[float, option("Chance of a name where nothing is missing.", "P")] = 0.01
    material: Annotated[
        float, option("Share of a joint's torque below which an effect does not matter.", "SHARE")
    ] = 0.003
    rival_se: Annotated[
        float, option("Standard errors within which two effects are rivals.", "Z")
    ] = 2.0
    seed: Annotated[
        int, option("Seed of the random residuals that show the effect of chance.", "N", min=0)
    ] = 0

    @property
    def given(self) -> dict[str, Any]:
        """Return them as keywords of the library, refused before the long work if invalid."""
        from ident.information.evidence import Decision

        Decision(self.alpha, self.material, self.rival_se)
        return vars(self)


def _unlogged_hands(mechanism: Mechanism, logs: Paths) -> tuple[str, ...]:
    """Return the joints of hands that all logs lack; of no log ([]), those that [log] lacks, and
    none where logs do not matter (None).
    """
    from ident.log.read import expanded, log_file
    from ident.mechanism.load import unlogged_hands

    if logs is None or not unlogged_hands(mechanism, ()):
        return ()
    columns = [c.column for c in mechanism.columns.values() if not c.group and not logs]
    paths: list[Path] = []
    with suppress(IdentError):  # reading the logs reports what is wrong with them
        paths = expanded(logs)[:LOOKED_AT]
    for path in paths:
        with suppress(IdentError):
            columns += log_file(path, None).table().columns
        if columns and not unlogged_hands(mechanism, columns):
            return ()
    return unlogged_hands(mechanism, columns) if columns else ()


def with_effect(mechanism: Mechanism, text: str, *, allow_code: bool) -> Mechanism:
    """Return the mechanism with an effect of the library, or with one of a Python file."""
    from ident.effects import parse_user, read_user_effect

    user_effect = parse_user(text)
    if user_effect is None:
        return mechanism.with_effect(text)
    file, name, joints = user_effect
    return mechanism + read_user_effect(file, name, allow_code=allow_code)(joints)


def read_logs(mechanism: Mechanism, paths: Sequence[Path], poses: bool | None = None) -> list[Log]:
    """Return some logs, those in folders among them; `poses` as in `ident.complete`."""
    from ident.log.read import expanded
    from ident.motion.motion import log_of

    with naming_unused(mechanism):
        return [log_of(mechanism, path, poses) for path in expanded(paths)]


@contextmanager
def naming_unused(mechanism: Mechanism) -> Iterator[None]:
    """Add to errors that propose entries of mechanism.toml that one is beside the bare URDF."""
    try:
        yield
    except IdentError as error:
        from ident.mechanism.load import unused_toml

        unused = unused_toml(mechanism.urdf, mechanism.toml)
        if not unused or "mechanism.toml" not in str(error):
            raise
        raise type(error)(f"{error}; {unused}") from None


def many(paths: Sequence[Path], jobs: int | None, scheduler: str | None) -> bool:
    """Return whether logs are to be worked on one by one: a folder, or on several processes."""
    from ident.log.read import is_folder_of_logs

    if jobs is not None and scheduler is not None:
        raise IdentError(f"--jobs {jobs}: is of this machine, not of {scheduler}; give one of them")
    return jobs is not None or scheduler is not None or any(map(is_folder_of_logs, paths))


# --- files that are written ----------------------------------------------------------------------


def output_folder(
    out: Path | None, names: Sequence[str] = (), inputs: Iterable[Path | None] = ()
) -> None:
    """Refuse --out, before the long work, where files `names` cannot be written or are inputs."""
    if out is not None:
        check_writable(out)
        for name in names:
            _refuse_input(out / name, inputs)


def output_file(
    path: Path | None, suffixes: Sequence[str], inputs: Iterable[Path | None] = ()
) -> None:
    """Refuse a file to be written, before the long work, by its suffix, folder, or as an input."""
    if path is None:
        return
    if path.suffix.lower() not in suffixes:
        raise IdentError(f"{path}: unknown suffix '{path.suffix}'; valid: {', '.join(suffixes)}")
    if path.is_dir():
        raise IdentError(f"{path}: is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise IdentError(f"{path}: there is no folder {path.parent}; make it, or name another one")
    check_writable(path.parent)
    _refuse_input(path, inputs)


def _refuse_input(target: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse a file or folder to be written that is an input, contains one, or would become one."""
    end = Path(os.path.realpath(target))  # `resolve` fails on a link that leads to itself
    for path in filter(None, inputs):
        given = Path(os.path.realpath(path))
        joins = given.is_dir() and end.parent == given and end.suffix in LOGS
        if joins or end in (given, *given.parents):
            raise IdentError(
                f"{target}: would be overwritten or read as a log, since {path} is an input of "
                "this command; give another name for the output"
            )


# --- values of options ---------------------------------------------------------------------------


def value(text: str, given: str, remedy: str, read: Callable[[str], Any] = float) -> Any:
    """Return what `read` makes of an option's text; its ValueError becomes one line."""
    try:
        return read(text)
    except ValueError:
        raise IdentError(f"{given} {text}: {remedy}") from None


def named(
    texts: Texts, given: str, remedy: str, read: Callable[[str], Any], *, bare: str = ""
) -> dict[str, Any]:
    """Return values by name from texts NAME=VALUE of the option `given`, each made by `read`.

    `bare` is the word for a single VALUE for all joints, where that is valid; its name is "".
    """

    def pair(text: str) -> tuple[str, Any]:
        name, equals, content = (part.strip() for part in text.rpartition("="))
        if not name and not (bare and not equals):
            raise ValueError
        return name, read(content)

    by_name: dict[str, Any] = {}
    for text in texts or ():
        name, content = value(text, given, remedy, pair)
        if by_name.setdefault(name, content) != content and name:
            raise IdentError(f"{given} {text}: '{name}' has another value already; give one")
    if "" in by_name and texts and texts[1:]:
        how = f"give one {bare} for all drives, or JOINT={bare} for each"
        raise IdentError(f"{given} {' '.join(texts)}: {how}")
    return by_name


def finite(text: str) -> float:
    """Return a finite number."""
    number = float(text)
    if not math.isfinite(number):
        raise ValueError
    return number


def interval(text: str) -> tuple[float, float]:
    """Return the two values of LOW:HIGH; one that is left out is infinite."""
    low, high = text.split(":")
    if not low + high:
        raise ValueError
    return float(low or "-inf"), float(high or "inf")


def share(text: str) -> tuple[float, bool]:
    """Return a number from 0, 20% as 0.2, and whether it was in percent."""
    number, percent = finite(text.removesuffix("%")), text.endswith("%")
    if number < 0:
        raise ValueError
    return number / 100 if percent else number, percent
