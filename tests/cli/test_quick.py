"""What must be quick is: nothing heavy is imported before a command is run."""

import subprocess
import sys
from importlib import import_module

import pytest

import ident
from ident.cli.app import COMMANDS, app, command_of

HEAVY = ("casadi", "pinocchio", "scipy", "matplotlib", "polars", "bokeh", "viser")


@pytest.mark.parametrize("words", [("--version",), ("--help",)])
def test_these_import_nothing_heavy(words):
    code = (
        "import sys\n"
        "from ident.cli.app import app\n"
        f"try: app({list(words)!r})\n"
        "except SystemExit: pass\n"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert said.splitlines()[-1] == "HEAVY []"


def test_commands_begin_before_anything_heavy_is_imported():
    code = (
        "import sys\n"
        "from ident.cli.app import COMMANDS, command_of\n"
        "for name in COMMANDS: command_of(name)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


def test_identify_imports_no_part_of_scipy_that_it_does_not_use(robots):
    """Each of these takes 0.1 to 0.5 s to import, beside half a second of work."""
    slow = [f"scipy.{name}" for name in ("interpolate", "ndimage", "signal", "stats")]
    code = (
        "import sys\n"
        "from ident.cli.app import app\n"
        f"try: app(['identify', {str(robots / 'arm')!r}, {str(robots / 'arm/run.csv')!r}])\n"
        "except SystemExit: pass\n"
        f"print('SLOW', [name for name in {slow!r} if name in sys.modules])"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines()[-1] == "SLOW []"


def test_the_list_of_commands_says_what_they_say():
    for name, (_, line) in COMMANDS.items():
        assert command_of(name).help.splitlines()[0] == line


def test_a_verb_is_not_hidden_by_the_package_of_its_name():
    for name in ("ident.diagnosis.selection", "ident.simulate.integrate"):
        import_module(name)
    for name in ident.__all__:
        assert not isinstance(getattr(ident, name), type(sys)), name
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        ident.nothing  # noqa: B018
    assert "diagnose" in dir(ident)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("ident di", {"diagnose"}),
        ("ident effects st", {"stribeck"}),
        ("ident add arm cou", {"coulomb", "coupling"}),
        ("ident diagnose arm run.csv --with vi", {"viscous"}),
        ("ident identify --smo", {"--smoothing"}),
    ],
)
def test_the_tab_key(typed, offered, monkeypatch, capsys):
    monkeypatch.setenv("_IDENT_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", typed)
    monkeypatch.setenv("COMP_CWORD", str(len(typed.split()) - 1))
    with pytest.raises(SystemExit):
        app(prog_name="ident")
    assert set(capsys.readouterr().out.split()) == offered


def test_completion_can_be_installed(monkeypatch, tmp_path, capsys):
    """Typer installs it for the shell that runs the command; here there may be none."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))
    with pytest.raises(SystemExit):
        app(["--install-completion"], prog_name="ident")
    assert "complete" in "".join(p.read_text() for p in tmp_path.rglob("*.sh"))


def test_functions_that_use_the_package_go_to_other_processes():
    """As those of a notebook do, which are sent with all that they use."""
    import pickle

    import cloudpickle

    import ident

    assert pickle.loads(pickle.dumps(ident)) is ident
    assert cloudpickle.loads(cloudpickle.dumps(lambda: ident))() is ident
