"""The inside of the package in figures: size, structure, work done twice, time, memory.

    python benchmarks/inside.py [ROW ...]                    all rows, or some: see ROWS
    python benchmarks/inside.py --against SRC [ROW ...]      beside another checkout's src

Every row is measured in a process of its own, with BLAS on one thread. `IDENT_SOURCE` names another
checkout's `src` to be measured in place of this one; `--against` measures both in turn, and gives
the ratio of the first figures: this one's to the other's. Times are of the processor.
"""

from __future__ import annotations

import ast
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
SOURCE = Path(os.environ.get("IDENT_SOURCE", ROOT / "src"))
ARM = ROOT / "robots" / "arm"
KIND = re.compile(r"# (tuned|level|range|numerics|work|shown)(?::|$)")  # see CONTRIBUTING.md
SHOWN = {"show", "cli", "chart", "page", "view", "demo", "explore"}


def main() -> None:
    wanted = sys.argv[1:]
    if wanted[:1] == ["--one"]:
        print(ROWS[wanted[1]]())
        return
    sources = [SOURCE]
    if wanted[:1] == ["--against"]:
        sources, wanted = [Path(wanted[1]), SOURCE], wanted[2:]
    ratio = len(sources) > 1
    print("| what | before | now | ratio |\n|---|---|---|---|" if ratio else HEAD)
    for name in wanted or ROWS:
        words = [figure(name, source) for source in sources]
        if ratio:
            words.append(ratio_of(*words))
        print(f"| {name} | {' | '.join(words)} |", flush=True)


HEAD = "| what | figure |\n|---|---|"


def figure(name: str, source: Path) -> str:
    """The figure of a row, of the package in some `src`, in a process of its own."""
    environment = {
        **os.environ,
        "IDENT_SOURCE": str(source),
        "PYTHONPATH": str(source),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, __file__, "--one", name]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return run.stdout.strip() or "failed: " + run.stderr.strip().splitlines()[-1]


def ratio_of(before: str, now: str) -> str:
    """The ratio of the first figures of two cells, those after a semicolon or comma as well."""
    numbers = [
        [*map(float, re.findall(r"(?:^|[;,] )(?:[a-z ]*)([0-9.]+)", x))] for x in (before, now)
    ]
    pairs = zip(*numbers, strict=False)
    return ", ".join(f"{b / a:.2f}" for a, b in pairs if a)


# --- structure ---------------------------------------------------------------------------------


def modules() -> dict[str, tuple[Path, ast.Module]]:
    """Every module by its dotted name."""
    found = {}
    for file in sorted((SOURCE / "ident").rglob("*.py")):
        name = ".".join(file.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
        found[name] = file, ast.parse(file.read_text(encoding="utf-8"))
    return found


def lines() -> str:
    files = (SOURCE / "ident").rglob("*")
    kinds = (".py", ".js", ".css", ".jinja", ".toml", ".urdf")
    own = [len(f.read_text(encoding="utf-8").splitlines()) for f in files if f.suffix in kinds]
    python = sum(len(file.read_text().splitlines()) for file, _ in modules().values())
    return f"{sum(own)}, of which Python {python}"


def count() -> str:
    return str(len(modules()))


def circles() -> str:
    """Strongly connected components of the imports, wherever they stand, of more than one file."""
    import networkx

    found = modules()
    graph = networkx.DiGraph()
    for name, (_, tree) in found.items():
        for other in imported(tree):
            target = other if other in found else other.rpartition(".")[0]
            if target in found and target not in (name, "ident"):
                graph.add_edge(name, target)
    parts = [part for part in networkx.strongly_connected_components(graph) if len(part) > 1]
    return (
        f"{len(parts)} (of {', '.join(str(len(part)) for part in parts)} files)" if parts else "0"
    )


def imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def classes() -> str:
    where = defaultdict(list)
    for name, (_, tree) in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(name)
    return str(sum(len(places) > 1 for places in where.values()))


def numbers() -> str:
    """Count of the named numbers of the kernel by kind."""
    found = Counter(kind for *_, kind in named_numbers())
    return f"{found.total()}: " + ", ".join(f"{n} {kind}" for kind, n in found.most_common())


def named_numbers() -> Iterator[tuple[str, str, str]]:
    """Module, name and kind of every named number of the kernel."""
    for module, (file, tree) in modules().items():
        if set(module.split(".")) & SHOWN:
            continue
        lines = file.read_text(encoding="utf-8").splitlines()
        for node in tree.body:
            if not isinstance(node, ast.Assign):
                continue
            inner = [*ast.walk(node.value)]
            values = [each.value for each in inner if isinstance(each, ast.Constant)]
            code = any(isinstance(each, (ast.Call, ast.Dict, ast.DictComp)) for each in inner)
            if values and not code and all(type(each) in (int, float) for each in values):
                names = [n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name)]
                kind = kind_of(lines, node)
                yield from ((module, name, kind) for name in names if name.isupper())


def kind_of(lines: list[str], node: ast.Assign) -> str:
    """The first word of the comment behind a number, or of the comment above it."""
    above = node.lineno - 1
    while above and lines[above - 1].startswith("#"):
        above -= 1
    own = [*lines[node.lineno - 1 : node.end_lineno], *lines[above : node.lineno - 1]]
    found = (match for line in own if (match := KIND.search(line)))
    return next((match[1] for match in found), "without a kind")


# --- work --------------------------------------------------------------------------------------


def noisy_arm() -> tuple[Any, Any]:
    """robots/arm with friction, and 2,000 samples of it: positions and torques with noise."""
    import ident

    mechanism = ident.load(ARM).with_effect("viscous").with_effect("coulomb")
    values = {name: 0.3 for effect in mechanism.effects for name in effect.names}
    log, _ = ident.simulate(
        mechanism, ident.read_log(ARM / "run.csv"), values=values, columns=["q", "tau"], seed=1,
        noise=[ident.Noise("tau", 0.01, True), ident.Noise("q", 2e-4)],
    )  # fmt: skip
    return mechanism, log


def functions() -> str:
    """Distinct functions and files of the package that the command `identify` runs, clean log."""
    from ident.cli.app import main as command

    seen = set()

    def profile(frame: Any, event: str, _: Any) -> None:
        named = frame.f_code.co_flags & 1  # no module and no body of a class
        if event == "call" and named and frame.f_code.co_filename.startswith(str(SOURCE)):
            seen.add((frame.f_code.co_filename, frame.f_code.co_qualname))

    sys.argv = ["ident", "identify", str(ARM), str(ARM / "run.csv"), "--with", "viscous", "--with",
                "coulomb"]  # fmt: skip
    with quiet():
        sys.setprofile(profile)
        try:
            command()
        except SystemExit:
            pass
        finally:
            sys.setprofile(None)
    real = {(file, name) for file, name in seen if "<module>" not in name and "<" not in name[:1]}
    named = [name for _, name in real if not name.endswith(">")]  # others: comprehensions, lambdas
    files = len({file for file, _ in real})
    return f"{len(named)} functions in {files} files, {len(real) - len(named)} comprehensions"


class quiet:
    """Standard output and error to nowhere, for a while."""

    def __enter__(self) -> None:
        self.kept = os.dup(1), os.dup(2)
        self.null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(self.null, 1)
        os.dup2(self.null, 2)

    def __exit__(self, *_: object) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(self.kept[0], 1)
        os.dup2(self.kept[1], 2)


def evaluations(verb: Callable[[], object]) -> str:
    """Evaluations of Γ over distinct samples while `verb` runs."""
    import numpy as np

    from ident.mechanism import parameters

    original, count, seen = parameters.regressor, [0], set()

    def counted(model: Any, q: Any, v: Any, a: Any, *more: Any, **options: Any) -> Any:
        count[0] += len(q)
        seen.update(row.tobytes() for row in np.ascontiguousarray(np.hstack([q, v, a])))
        return original(model, q, v, a, *more, **options)

    for other in list(sys.modules.values()):
        if getattr(other, "regressor", None) is original:
            other.regressor = counted
    verb()
    return f"{count[0] / max(len(seen), 1):.2f} ({count[0]} for {len(seen)})"


def once_identify() -> str:
    """The paper's slider-crank, with noise of 1 % (40 dB) on every channel."""
    import ident

    mechanism = ident.load(ROOT / "robots" / "slider_crank")
    noise = [ident.Noise(channel, 0.01, True) for channel in ("q", "v", "a", "tau")]
    given = ident.read_log(ROOT / "robots" / "slider_crank" / "run.csv")
    log, _ = ident.simulate(mechanism, given, noise=noise, seed=1)
    motion = ident.complete(mechanism, log)
    return evaluations(lambda: ident.identify(mechanism, motion))


def once_diagnose() -> str:
    import ident

    mechanism, log = noisy_arm()
    fit = ident.identify(mechanism, ident.complete(mechanism, log))
    return evaluations(lambda: ident.diagnose(fit))


# --- time and memory ---------------------------------------------------------------------------


def timed(verb: Callable[[], object]) -> tuple[float, object]:
    start = time.process_time()
    result = verb()
    return time.process_time() - start, result


def diagnose() -> str:
    sys.path.insert(0, str(HERE))
    import arm6

    import ident

    model = arm6.mechanism()
    words = []
    for hidden in (arm6.HIDDEN, None):
        log = arm6.log(model, 10_000, hidden)
        fit = ident.identify(model, ident.complete(model, log, cutoff=41.0))  # 3,300 rows a joint
        seconds, found = timed(lambda fit=fit: ident.diagnose(fit))
        words.append(f"{seconds:.1f} s ({found.verdict}: {found.best})")
    return f"{words[0]}; nothing hidden {words[1]}; {memory()}"


def grow() -> str:
    import ident

    data = Path(os.environ.get("IDENT_DATA", ROOT.parent / "shared" / "data")) / "staubli_tx40"
    mechanism = ident.load(data / "tx40.urdf")
    motion = ident.complete(mechanism, data / "tx40.csv")
    seconds, history = timed(lambda: ident.grow(mechanism, motion))
    errors = [f"{100 * (e.relative or 0):.1f}" for e in history.fit.held_out.values()]
    names = ", ".join(effect.label for effect in history.added)
    return f"{seconds:.0f} s, held out {' '.join(errors)} %: {names}; {memory()}"


def identify() -> str:
    sys.path.insert(0, str(HERE))
    import arm7
    import numpy as np

    import ident

    model, words = arm7.mechanism(), []
    for samples in (10_000, 100_000):
        log = arm7.log(model, samples, 0.01)
        best = np.inf
        for _ in range(3):  # a motion keeps what was made of it: a new one each time
            motion = ident.complete(model, log)
            best = min(best, timed(lambda motion=motion: ident.identify(model, motion))[0])
        words.append(f"{1e6 * best / samples:.1f} µs a sample at {samples}")
    return "; ".join(words)


def command() -> str:
    """Processor time of the whole command `ident identify robots/arm robots/arm/run.csv`, its
    modules compiled, as they are from the second time on.
    """
    words, compiled = [], {k: x for k, x in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "ident", "identify", str(ARM), str(ARM / "run.csv")],
            capture_output=True, check=True, env=compiled,
        )  # fmt: skip
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        words.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return f"{min(words):.2f} s (best of 3)"


def commands() -> str:
    """Largest memory of each command on 10,000 samples of seven joints."""
    sys.path.insert(0, str(HERE))
    import arm7

    import ident

    words = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "arm7.urdf").write_text(arm7.urdf())
        arm7.log(ident.load(folder / "arm7.urdf").with_effect("viscous"), 10_000, 0.01).write(
            folder / "run.csv"
        )
        given = [str(folder / "arm7.urdf"), str(folder / "run.csv")]
        for verb in ("check", "identify", "diagnose", "grow"):
            script = (
                "import resource, subprocess, sys;"
                f"subprocess.run([sys.executable, '-m', 'ident', '{verb}', *{given!r}],"
                "capture_output=True, check=True);"
                "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6)"
            )
            run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
            words.append(f"{verb} {float(run.stdout or 'nan'):.2f} GB")
    return ", ".join(words)


def memory() -> str:
    return f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB"


ROWS: dict[str, Callable[[], str]] = {
    "lines": lines,
    "modules": count,
    "circles of imports": circles,
    "class names defined twice": classes,
    "named numbers": numbers,
    "identify runs": functions,
    "evaluations of Γ, identify": once_identify,
    "evaluations of Γ, diagnose": once_diagnose,
    "diagnose": diagnose,
    "grow": grow,
    "identify": identify,
    "command": command,
    "memory": commands,
}

if __name__ == "__main__":
    main()
