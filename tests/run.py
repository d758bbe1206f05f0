"""Installs the project with its test tools into .venv-test and runs every check. Needs only Python.

The environment is the tests' own, so that the one that a user works in stays as it is. What decides
must not depend on the processor: a sample of the numerical tests runs again with the arithmetic of
two other ones, of older and newer instructions.

On Debian, as root, it installs the browser that reports are opened in as well; without one, those
tests are skipped and say so.

python3 tests/run.py            formatter, linter, type checker, tests
python3 tests/run.py --slow     the long suites as well
"""

import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENT = ROOT / ".venv-test"
BIN = ENVIRONMENT / ("Scripts" if os.name == "nt" else "bin")
FIRST = (
    ("pip", "install", "--quiet", "--editable", ".[test]"),
    ("ruff", "format", "--check", "."),
    ("ruff", "check", "."),
)
TYPES = ("mypy",)  # beside the tests, which leave a core alone where they wait
# files in their order: the longest are not the last, where a worker would wait for them
TESTS = ("pytest", "-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder")

CORES = ("Haswell", "Sandybridge")  # kernels of OpenBLAS, which any x86 since 2013 runs
SAMPLE = ("tests/kernel", "tests/truth", "--every", "20", "-p", "no:cacheprovider")
X86 = ("x86_64", "AMD64")

SYSTEM = ("chromium", "python3-venv")  # packages: the browser, and what makes environments


def system() -> None:
    """Installs Debian's packages that are missing, as root; tests without a browser are skipped."""
    found = (shutil.which("chromium"), importlib.util.find_spec("ensurepip"))
    missing = [name for name, there in zip(SYSTEM, found, strict=True) if there is None]
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    if not missing or not root or not shutil.which("apt-get"):
        return
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    install = ("apt-get", "install", "-qq", "-y", "--no-install-recommends", *missing)
    for _ in range(2):  # a mirror may be busy
        for command in (("apt-get", "update", "-qq"), install):
            print("+", *command, flush=True)
            status = subprocess.run(command, env=environment, check=False).returncode
        if status == 0:
            return
    print(f"could not install {', '.join(missing)}: tests that need them are skipped", flush=True)


def started(tool: str, *arguments: str, core: str = "", **options: object) -> subprocess.Popen[str]:
    # workers share the cores; processes that tests start need not compile the package anew
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
    if core:
        environment["OPENBLAS_CORETYPE"] = core
    print("+", *filter(None, [core]), tool, *arguments, flush=True)
    command = [str(BIN / "python"), "-m", tool, *arguments]
    return subprocess.Popen(command, cwd=ROOT, env=environment, text=True, **options)


def failed(tool: str, status: int) -> bool:
    if status:
        print(f"{tool} failed with status {status}", flush=True)
    return bool(status)


def main() -> int:
    system()
    if not (BIN / "python").exists():
        venv.create(ENVIRONMENT, with_pip=True)
    for check in FIRST:
        if failed(check[0], status := started(*check).wait()):
            return status
    long = ("-m", "slow or not slow") if "--slow" in sys.argv[1:] else ()
    with started(*TYPES, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as types:
        tests = started(*TESTS, *long).wait()
        print(types.communicate()[0], end="", flush=True)
    cores = CORES if platform.machine() in X86 else ()
    # beside each other: no worker waits for the longest file of a small sample
    workers = str(max(1, (os.cpu_count() or 1) // len(CORES)))
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    command = ("pytest", "-n", workers, *TESTS[3:], *SAMPLE)
    samples = [(core, started(*command, core=core, **piped)) for core in cores]
    others = []
    for core, sample in samples:
        print(sample.communicate()[0], end="", flush=True)
        others.append(failed(f"pytest as {core}", sample.returncode))
    return int(failed("pytest", tests) | failed("mypy", types.returncode) | any(others))


if __name__ == "__main__":
    sys.exit(main())
