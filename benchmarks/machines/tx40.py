"""Stäubli TX40, six joints, wrist coupled: shared data, of thanhndv212/figaroh-examples."""

from pathlib import Path

from machines import Machine

SOURCE, COMMIT = "staubli_tx40", ""
PUBLISHED = "friction and coupling of the wrist, 7.6 8.5 10.0 10.2 14.1 15.5 % (train)"


def convert(source: Path, folder: Path) -> Machine:
    """One log; errors are held out in time."""
    return Machine(source / "tx40.urdf", (source / "tx40.csv",))
