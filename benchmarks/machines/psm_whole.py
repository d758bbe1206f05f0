"""Patient-side arm of a da Vinci Research Kit with its wrist and the wrist's motors: see `psm`.

Sixteen bodies, seven drives: the three motors of the wrist sit at the base and turn the wrist and
two jaws through cables, the sixteenth body carries the friction between the jaws.
"""

from pathlib import Path

from machines import Machine, psm

SOURCE, COMMIT, BAND = psm.SOURCE, psm.COMMIT, psm.BAND
PUBLISHED = "9.3 17.8 19.1 13.4 % of the first four below 5.4 Hz"
JAW = 0.0091  # m, from the wrist to each jaw, main_psm.ipynb
WRIST, BACK, TURN = 1.0186, -0.8306, 1.2178  # ratios of the cables, ibid.
QUARTER = psm.QUARTER
ARM = psm.Arm(
    origins=psm.ARM.origins
    | {
        "wrist": (0, 0, 0, QUARTER), "jaw_1": (JAW, 0, 0, -QUARTER), "jaw_2": (JAW, 0, 0, -QUARTER),
        "motor_5": (0, 0, 0, 0), "motor_6": (0, 0, 0, 0), "motor_7": (0, 0, 0, 0),
        "between_jaws": (0, 0, 0, 0),
    },
    parents=psm.ARM.parents
    | {"wrist": "roll", "jaw_2": "wrist"}
    | dict.fromkeys(("motor_5", "motor_6", "motor_7", "between_jaws")),
    driven=psm.ARM.driven | {"motor_5": 0.0, "motor_6": 0.0, "motor_7": 0.0},
    follow=psm.ARM.follow
    | {
        "wrist": ({"motor_5": WRIST}, QUARTER),
        "jaw_1": ({"motor_5": BACK, "motor_6": TURN}, QUARTER),
        "jaw_2": ({"motor_5": BACK, "motor_7": TURN}, QUARTER),
        "between_jaws": ({"motor_6": -TURN, "motor_7": TURN}, 0.0),
    },
)  # fmt: skip


def convert(source: Path, folder: Path) -> Machine:
    """All seven joints; both logs are fitted, as much as there is."""
    logs = psm.write(ARM, source, folder)
    return Machine(folder, logs)
