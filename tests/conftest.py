"""Where the project and the shared measurements are."""

import os
import sys
import zlib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# the workers of pytest share the cores: where no number is given, `jobs` is this process alone, and
# threads of linear algebra that wait for each other take four times as long
for name in ("LOKY_MAX_CPU_COUNT", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--every N`: a sample of the tests, the same in every run."""
    parser.addoption("--every", type=int, default=1, help="run every N-th test only, by its name")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the sample that `--every` asks for."""
    if (every := config.getoption("--every")) > 1:
        items[:] = [x for x in items if zlib.crc32(x.nodeid.encode()) % every == 0]


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


@pytest.fixture
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops that no start closes are given up after a tenth of the processor's time."""
    monkeypatch.setattr("ident.mechanism.assembly.SEARCH", 0.5)


@pytest.fixture
def spoken(monkeypatch, capsys):
    """`spoken(*words)`: exit status, standard output and standard error of `ident WORDS`."""
    from ident.cli.app import main

    def run(*words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["ident", *map(str, words)])
        status = 0
        try:
            main()
        except SystemExit as stop:
            status = int(stop.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


CHROMIUM = Path("/usr/bin/chromium")
ARGUMENTS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    # WebGL is drawn by the emulated graphics processor; text and charts are faster without it
    "--disable-gpu-compositing", "--disable-gpu-rasterization", "--disable-accelerated-2d-canvas",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run",
]  # fmt: skip


PATIENCE = 60_000  # ms, for a page drawn in software on a busy machine


def patient(make):
    """`make`, what it makes waiting for `PATIENCE` where nothing else is asked for."""

    def made(**options):
        new = make(**options)
        new.set_default_timeout(PATIENCE)
        return new

    return made


@pytest.fixture(scope="session")
def browser():
    """Debian's browser, drawing in software, whose pages are waited for."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM.exists():
        pytest.skip(f"there is no browser at {CHROMIUM}; apt-get install chromium")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=str(CHROMIUM), args=ARGUMENTS)
        opened.new_page, opened.new_context = map(patient, (opened.new_page, opened.new_context))
        yield opened
        opened.close()
