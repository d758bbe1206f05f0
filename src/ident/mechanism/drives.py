"""Where a joint's torque comes from if no sensor measures it: [drives] of mechanism.toml, --drive.

    [drives]                 # the same for all driven joints …
    kp = 30.0                # N m/rad; a value that is given is known, else unknown
    [drives.elbow]           # … and of one joint
    kp = 20.0
    kd = 1.5                 # N m s/rad on q̇; follows = "velocity": on dref − q̇
    delay = 0.004            # s
    limit = 23.7             # N m
    hold = "constant"        # of the command between samples, or "linear"; else as the log shows

A drive is an effect that supplies the torque of its joint (`ident.effects.servo`): a position
servo, a motor whose current is logged (`kt`), or one that is driven by volts (`gain`, `kb`).
Drives whose delay is not given have one unknown delay in common, that of their bus.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from ident.effects import Effect, create
from ident.errors import one_of
from ident.files import TomlTable

KEYS = {  # of a drive's kind, in mechanism.toml and --drive
    "servo": ("kp", "kd", "delay", "limit", "hold", "follows"),
    "motor_current": ("kt", "limit"),
    "motor_voltage": ("gain", "kb", "delay", "limit", "hold"),
    "motor_duty": ("gain", "kb", "delay", "limit", "hold"),
}
SOURCES = {
    "servo": "servo",
    "current": "motor_current",
    "voltage": "motor_voltage",
    "duty": "motor_duty",
}
HOLDS = ("constant", "linear")  # of a command between its samples
POSITIVE = ("kp", "kt", "gain", "limit")  # that must be above zero


def read_drives(section: TomlTable, driven: Sequence[str]) -> list[Effect]:
    """Return the drives of [drives]: keys of the table itself are of all driven joints.

    Raises:
        MechanismError: for a joint that is not driven, an unknown key, or an impossible value.
    """
    common = {key: x for key, x in section.data.items() if not isinstance(x, dict)}
    joints = [key for key, x in section.data.items() if isinstance(x, dict)]
    for joint in joints:
        if joint not in driven:
            raise section.error(f"no driven joint '{joint}'; {one_of(joint, driven)}")
    of_all = bool(common) or not joints
    tables = {
        joint: TomlTable(
            f"{section.where}.{joint}" if joint in joints else section.where,
            {**common, **section.data.get(joint, {})},
        )
        for joint in driven
        if of_all or joint in joints
    }
    return with_common_delay([drive_of(joint, table) for joint, table in tables.items()])


def drive_of(joint: str, table: TomlTable) -> Effect:
    """Return the drive of a joint from the keys of its table."""
    data = dict(table.data)
    if "source" in data:
        word = table.text("source")
        if word not in SOURCES:
            raise table.error(f"source = '{word}'; {one_of(word, SOURCES)}")
        kind = SOURCES[word]
    else:
        gains = {kind: {*keys[:2]} - {"limit"} for kind, keys in KEYS.items()}
        kind = next((kind for kind, keys in gains.items() if keys & {*data}), "servo")
    table.check("source", *KEYS[kind])
    values = {key: table.number(key) for key in data if key not in ("source", "follows", "hold")}
    for key, value in values.items():
        if value < 0 or (key in POSITIVE and value == 0):
            valid = "a number above 0" if key in POSITIVE else "a number of 0 or more"
            raise table.error(f"{key} = {value:g}; {valid} is expected")
    if "follows" in data:
        word = table.text("follows")
        if word not in ("position", "velocity"):
            raise table.error(f"follows = '{word}'; {one_of(word, ('position', 'velocity'))}")
        values["follows_velocity"] = float(word == "velocity")
    if "hold" in data:
        word = table.text("hold")
        if word not in HOLDS:
            raise table.error(f"hold = '{word}'; {one_of(word, HOLDS)}")
        values["linear"] = float(word == "linear")
    return create(kind, joint, values)


def with_common_delay(drives: Sequence[Effect]) -> list[Effect]:
    """Return drives with the delay that those share whose own is not given."""
    late = [
        drive.joints[0]
        for drive in drives
        if "delay" in drive.settings and "delay" not in drive.values
    ]
    return [*drives, *([create("command_delay", late)] if late else [])]


def parse_drives(texts: Collection[str], driven: Sequence[str]) -> list[Effect]:
    """Return the drives of options `JOINT:kp=20,kd=1.5`, or `kp=20,kd=1.5` for all joints.

    Raises:
        MechanismError: for a joint that is not driven, an unknown key, or an impossible value.
    """
    data: dict[str, object] = {}
    for text in texts:
        joint, colon, rest = text.partition(":")
        if not colon and "=" in text:
            joint, rest = "", text
        values: dict[str, object] = {}
        for part in filter(None, rest.split(",")):
            key, _, word = part.partition("=")
            try:
                values[key.strip()] = float(word)
            except ValueError:
                values[key.strip()] = word.strip()
        if not joint or (not colon and joint in SOURCES):
            data |= values or {"source": joint}
        else:
            data[joint] = values
    return read_drives(TomlTable("--drive", data), driven) if texts else []
