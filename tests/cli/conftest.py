"""`ident` run in this process through its real entry point, and mechanisms to break."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from ident.cli.app import main

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0 0" rpy="0 0 0"/>
      <mass value="1.5"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>
    </inertial>
  </link>
  <link name="fore">
    <inertial>
      <mass value="0.5"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.002"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/>
    <axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="5" effort="50"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/>
    <child link="fore"/>
    <origin xyz="0.3 0 0"/>
    <axis xyz="0 1 0"/>
  </joint>
  <joint name="flange" type="fixed">
    <parent link="fore"/>
    <child link="tool"/>
  </joint>
</robot>
"""


@dataclass(frozen=True)
class Outcome:
    """What a command left: exit status, standard output, standard error."""

    status: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def ident(monkeypatch, capfd) -> Run:
    """`ident(*arguments)`, with what reaches the file descriptors, from C++ as well."""

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["ident", *map(str, arguments)])
        capfd.readouterr()
        status = 0
        try:
            main()
        except SystemExit as stop:
            status = stop.code or 0
        out, err = capfd.readouterr()
        return Outcome(status, out, err)

    return run


@pytest.fixture
def done(ident) -> Run:
    """As `ident`, for what must succeed: status 0, and nothing but notes on standard error."""

    def run(*arguments: object) -> Outcome:
        outcome = ident(*arguments)
        assert outcome.status == 0, outcome.err
        assert all(line.startswith("note: ") for line in outcome.err.splitlines()), outcome.err
        return outcome

    return run


@pytest.fixture
def checked() -> Callable[[int, str, str, tuple[str, ...]], None]:
    """`checked(status, out, err, words)`: what `refused` asks for, of another process."""
    return lambda status, out, err, words: check_refusal(Outcome(status, out, err), words)


@pytest.fixture
def refused(ident) -> Run:
    """`refused(words, *arguments)`: status 1, no result, and one line with all the words in it."""

    def run(words: tuple[str, ...], *arguments: object) -> Outcome:
        outcome = ident(*arguments)
        check_refusal(outcome, words)
        return outcome

    return run


def check_refusal(outcome: Outcome, words: tuple[str, ...]) -> None:
    assert outcome.status == 1, (outcome.status, outcome.out[-300:], outcome.err)
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert outcome.err.startswith("error: ")
    assert "fault of ident" not in outcome.err
    assert outcome.out == ""
    assert not [word for word in words if word not in outcome.err], outcome.err


@pytest.fixture
def slider(robots: Path, tmp_path: Path) -> Path:
    """A copy of the slider-crank's folder to work on, its log thinned to 401 samples."""
    return copy(robots, tmp_path, "slider_crank", thin=5)


@pytest.fixture(scope="session")
def fitted_once(robots: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with that of the slider-crank, and `out` with its fit."""
    place = tmp_path_factory.mktemp("fitted")
    slider, out = copy(robots, place, "slider_crank", thin=5), place / "out"
    words = "identify", slider, slider / "run.csv", "--with", "viscous:theta", "--out", out
    command = [sys.executable, "-m", "ident", *map(str, words)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stderr.count("note: wrote ") == 1
    assert "identified/" in run.stderr
    return place


@pytest.fixture
def pendulum(robots: Path, tmp_path: Path) -> Path:
    """A copy of the pendulum's folder to work on."""
    return copy(robots, tmp_path, "pendulum")


def copy(robots: Path, tmp_path: Path, name: str, thin: int = 1) -> Path:
    folder = tmp_path / name
    folder.mkdir()
    for file in (f"{name}.urdf", "mechanism.toml"):
        shutil.copy(robots / name / file, folder)
    header, *rows = (robots / name / "run.csv").read_text().splitlines(keepends=True)
    (folder / "run.csv").write_text("".join([header, *rows[::thin]]))
    return folder


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A bare URDF of two joints."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path


def edit(path: Path, old: str, new: str) -> None:
    """Replace a text that must be there once or more, all of it."""
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path.name}"
    path.write_text(text.replace(old, new))


@pytest.fixture
def change() -> Callable[[Path, str, str], None]:
    """`change(path, old, new)` in a text file."""
    return edit
