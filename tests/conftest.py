"""Where the project and the shared measurements are."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def robots(root: Path) -> Path:
    """The folder of mechanisms that come with the project."""
    return root / "robots"


@pytest.fixture(scope="session")
def shared_data(root: Path) -> Path:
    """Real measurements: `$IDENT_DATA`, or ../shared/data beside the checkout."""
    place = Path(os.environ.get("IDENT_DATA", root.parent / "shared" / "data"))
    if not place.is_dir():
        pytest.skip(f"no measurements at {place}; set IDENT_DATA to the folder of shared data")
    return place
