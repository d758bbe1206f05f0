"""KUKA KR300 R2500, two logs of 10 s: shared data, of JonasWeigand/Robot_Identification."""

from pathlib import Path

from machines import Machine

SOURCE, COMMIT = "kuka_kr300", ""
PUBLISHED = "counterbalance of a2, elastic gears of a1 to a3"


def convert(source: Path, folder: Path) -> Machine:
    """Identified from A, judged on B."""
    return Machine(source, (source / "A.csv",), (source / "B.csv",))
